// The error that the mesh itself makes, estimated from what a coarser mesh would make of the same potential.
#include <utility>

#include "solver/crs_backend.hpp"
#include "stencil/laplacian.hpp"

namespace amrpic {

namespace {

/// Rows in which the coarser Laplacian is no estimate: those at walls, and those beside half a pair of finer cells.
std::vector<char> rows_at_ends(Domain const& domain, Level const& level, Level const& finer, Index3 const& ratio) {
  std::vector<char> out(std::size_t(level.local_cells()));
  for (auto const& face : find_walls(domain, level).faces) out[face.row] = 1;
  for (int d = 0; d < 3; ++d) {
    int const n = finer.domain().extent(d);
    if (n % ratio[d] == 0) continue;
    LocalIndex row = 0;
    for (int b = level.first_local_box(); b < level.last_local_box(); ++b)
      for_each_cell(level.box(b), [&](Index3 const& cell) {
        if (cell[d] == 0 || cell[d] >= n / 2 - 1) out[row] = 1;
        ++row;
      });
  }
  return out;
}

using Rows = TpetraTypes::Rows;

/// What the wide Laplacian and the mean of f say of the truncation, in cells at no end whose children are all
/// uncovered: those of which the mean of `uncovered` is one.
void estimate(DeviceArray<char> const& at_end, DeviceArray<Real const> const& uncovered,
              DeviceArray<Real const> const& wide_laplacian, DeviceArray<Real const> const& mean_f,
              DeviceArray<Real> const& error) {
  Kokkos::parallel_for(
      "truncation", Rows(0, LocalIndex(at_end.extent(0))), KOKKOS_LAMBDA(LocalIndex row) {
        bool const usable = uncovered(row) > 1 - 1e-9 && !at_end(row);
        error(row) = usable ? truncation_error(wide_laplacian(row), mean_f(row)) : 0.0;
      });
}

void clear_covered(DeviceArray<char> const& mask, DeviceArray<Real> const& values) {
  Kokkos::parallel_for(
      "clear covered", Rows(0, LocalIndex(mask.extent(0))), KOKKOS_LAMBDA(LocalIndex row) {
        if (!mask(row)) values(row) = 0;
      });
}

}  // namespace

Real CrsBackend::largest_correction() {
  return unit_ * norm(
                     Norm::max, [&](int l) -> auto const& { return cycle_level(l).correction(); });
}

/// The truncation error of the composite Laplacian, into the right-hand sides of the cycle: for each cell what the
/// Laplacian of the next coarser level makes of the mean potentials there, less the mean of f, over three. Nothing is
/// known of cells at walls, and of the base where nothing coarser exists. `phi_` must be averaged down.
void CrsBackend::set_truncation() {
  for (int l = 0; l < hierarchy_->level_count(); ++l) {
    LevelOperators const& fine = operators(l);
    LevelVector& truncation = cycle_level(l).right_hand_side();
    truncation.set_zero();
    std::size_t const place = multigrid_levels_.base + std::size_t(l);
    if (place == 0) continue;
    LevelOperators const& coarse = *operators_[place - 1];
    LevelVector f(fine.cells), uncovered(fine.cells), phi(coarse.cells), error(coarse.cells);
    f.assign(right_hand_side_[std::size_t(l)]);
    f.update_halo();
    copy_in(fine.uncovered, uncovered.own());
    uncovered.update_halo();
    if (l > 0)
      phi.assign(phi_[std::size_t(l) - 1]);
    else
      coarse.restriction.multiply(phi_[0], phi);
    phi.update_halo();

    LevelVector wide(coarse.cells), mean_f(coarse.cells), share(coarse.cells);
    coarse.no_fine.multiply(phi, wide);
    coarse.restriction.multiply(f, mean_f);
    coarse.restriction.multiply(uncovered, share);
    auto const at_end = rows_at_ends(hierarchy_->domain(), *coarse.level, *fine.level, multigrid_levels_.ratio[place]);
    estimate(on_device(at_end), std::as_const(share).values(), std::as_const(wide).values(),
             std::as_const(mean_f).values(), error.values());
    error.update_halo();
    fine.prolongation.multiply(error, truncation);
    clear_covered(*fine.mask, truncation.values());
  }
}

/// Estimate of the largest error of phi that the mesh makes: one cycle with the truncation error; 0 while the residual
/// is too large beside it. What the cells of phi stand for is what those of f stand for: where f is the mean
/// over a cell, this is the error of the means of phi, which at cell centres is another one, by h^2/24 times f. Finds
/// and leaves the residual in the right-hand sides of the cycle.
Real CrsBackend::discretisation_error() {
  auto const right_hand_side = [&](int l) -> auto const& { return cycle_level(l).right_hand_side(); };
  if (operators_.size() == 1) return 0;  // nothing is coarser than the base, nothing finer
  Real const residual = norm(Norm::max, right_hand_side);
  set_truncation();
  Real error = 0;
  if (residual < 0.1 * norm(Norm::max, right_hand_side)) {
    multigrid_.cycle(stopwatch_);
    error = largest_correction();
  }
  compute_residual();
  return error;
}

}  // namespace amrpic
