// The error that the mesh itself makes, estimated from what a coarser mesh would make of the same potential.
#include <algorithm>
#include <cmath>

#include "base/for_rows.hpp"
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

}  // namespace

Real CrsBackend::largest_uncovered(std::vector<Real> const& (*values)(MultigridLevel&)) {
  Real result = 0;
  for (int l = 0; l < hierarchy_->level_count(); ++l) {
    auto const& v = values(cycle_level(l));
    for_each_uncovered(l, [&](LocalIndex row) { result = std::max(result, std::abs(v[row])); });
  }
  return hierarchy_->comm().largest(result);
}

Real CrsBackend::largest_correction() {
  return unit_ *
         largest_uncovered([](MultigridLevel& level) -> std::vector<Real> const& { return level.correction(); });
}

/// The truncation error of the composite Laplacian, into the right-hand sides of the cycle: for each cell what the
/// Laplacian of the next coarser level makes of the mean potentials there, less the mean of f, over three. Nothing is
/// known of cells at walls, and of the base where nothing coarser exists. `phi_` must be averaged down.
void CrsBackend::set_truncation() {
  for (int l = 0; l < hierarchy_->level_count(); ++l) {
    LevelOperators const& fine = operators(l);
    auto& truncation = cycle_level(l).right_hand_side();
    std::fill(truncation.begin(), truncation.end(), 0.0);
    std::size_t const place = multigrid_levels_.base + std::size_t(l);
    if (place == 0) continue;
    LevelOperators const& coarse = *operators_[place - 1];
    std::size_t const here = std::size_t(fine.rows() + fine.halo.size());
    std::size_t const there = std::size_t(coarse.rows() + coarse.halo.size());

    std::vector<Real> f(here), uncovered(here), phi(there), error(there);
    std::copy_n(right_hand_side_[l].begin(), fine.rows(), f.begin());
    std::copy_n(fine.uncovered.begin(), fine.rows(), uncovered.begin());
    fine.halo.update(f.data());
    fine.halo.update(uncovered.data());
    if (l > 0)
      phi = phi_[l - 1];
    else
      multiply(coarse.restriction, phi_[0].data(), phi.data());
    coarse.halo.update(phi.data());

    auto const at_end = rows_at_ends(hierarchy_->domain(), *coarse.level, *fine.level, multigrid_levels_.ratio[place]);
    coarse.restriction.for_each_row([&](LocalIndex row) {
      bool const usable = coarse.restriction.dot(row, uncovered.data()) > 1 - 1e-9;  // no child is covered
      if (usable && !at_end[row])
        error[row] = truncation_error(coarse.no_fine.dot(row, phi.data()), coarse.restriction.dot(row, f.data()));
    });
    coarse.halo.update(error.data());
    add_multiply(1.0, fine.prolongation, error.data(), truncation.data());
    for_rows(fine.rows(), [&](LocalIndex row) {
      if (!fine.uncovered[row]) truncation[row] = 0;
    });
  }
}

/// Estimate of the largest error of phi that the mesh makes: one cycle with the truncation error; 0 while the residual
/// is too large beside it. What the cells of phi stand for is what those of f stand for: where f is the mean
/// over a cell, this is the error of the means of phi, which at cell centres is another one, by h^2/24 times f. Finds
/// and leaves the residual in the right-hand sides of the cycle.
Real CrsBackend::discretisation_error() {
  auto const right_hand_side = [](MultigridLevel& level) -> std::vector<Real> const& {
    return level.right_hand_side();
  };
  if (operators_.size() == 1) return 0;  // nothing is coarser than the base, nothing finer
  Real const residual = largest_uncovered(right_hand_side);
  set_truncation();
  Real error = 0;
  if (residual < 0.1 * largest_uncovered(right_hand_side)) {
    multigrid_.cycle(stopwatch_);
    error = largest_correction();
  }
  compute_residual();
  return error;
}

}  // namespace amrpic
