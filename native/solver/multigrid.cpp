#include "solver/multigrid.hpp"

#include <algorithm>

#include "base/rows.hpp"

namespace amrpic {

namespace {

/// Rows of a level by the parity of i + j + k in the level's global indices, which no decomposition changes.
std::array<std::vector<LocalIndex>, 2> colours(Level const& level) {
  std::array<std::vector<LocalIndex>, 2> out;
  for (auto& rows : out) rows.reserve(std::size_t(level.local_cells()) / 2 + 1);
  LocalIndex row = 0;
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b)
    for_each_cell(level.box(b), [&](Index3 const& c) { out[(c[0] + c[1] + c[2]) & 1].push_back(row++); });
  return out;
}

}  // namespace

MultigridLevel::MultigridLevel(LevelOperators const& operators, SolverOptions const& options)
    : operators_(operators),
      pre_sweeps_(options.pre_sweeps),
      post_sweeps_(options.post_sweeps),
      relaxation_(options.relaxation),
      colour_(colours(*operators.level)) {
  std::size_t const own = std::size_t(operators.rows()), all = own + std::size_t(operators.halo.ghosts());
  right_hand_side_.resize(own);
  correction_.resize(all);
  residual_.resize(all);
}

/// Over-relaxed Gauss-Seidel on rows that do not couple with each other.
void MultigridLevel::relax(std::vector<LocalIndex> const& rows) {
  Crs const& a = operators_.no_fine;
  Real* const x = correction_.data();
  Real const* const f = right_hand_side_.data();
  for_rows(LocalIndex(rows.size()), [&, x, f](LocalIndex k) {
    LocalIndex const row = rows[std::size_t(k)];
    Real const diagonal = a.value[a.row_start[row]];
    x[row] += relaxation_ * (f[row] - a.dot(row, x)) / diagonal;
  });
}

void MultigridLevel::smooth(int sweeps) {
  for (int s = 0; s < sweeps; ++s)
    for (auto const& rows : colour_) {
      operators_.stencil_halo.update(correction_.data());
      relax(rows);
    }
}

void MultigridLevel::smooth_from_zero() {
  std::fill(correction_.begin(), correction_.end(), 0.0);
  if (pre_sweeps_ == 0) return;
  // nothing to read yet for the first colour
  relax(colour_[0]);
  operators_.stencil_halo.update(correction_.data());
  relax(colour_[1]);
  smooth(pre_sweeps_ - 1);
}

void MultigridLevel::pre_smooth_and_restrict(MultigridLevel& coarser) {
  smooth_from_zero();
  operators_.halo.update(correction_.data());
  for_rows(operators_.rows(), [&](LocalIndex row) {
    residual_[row] = right_hand_side_[row] - operators_.no_fine.dot(row, correction_.data());
  });
  operators_.halo.update(residual_.data());

  auto& coarse = coarser.right_hand_side_;
  LevelOperators const& c = coarser.operators_;
  c.restriction.for_each_row([&](LocalIndex row) {
    if (!c.uncovered[row]) coarse[row] = c.restriction.dot(row, residual_.data());
  });
  add_multiply(-1.0, c.fine_boundary, correction_.data(), coarse.data());
}

void MultigridLevel::prolong_and_post_smooth(MultigridLevel const& coarser) {
  add_multiply(1.0, operators_.prolongation, coarser.correction_.data(), correction_.data());
  add_multiply(-1.0, operators_.coarse_boundary, coarser.correction_.data(), right_hand_side_.data());
  smooth(post_sweeps_);
}

Multigrid::Multigrid(MPI_Comm comm, std::vector<LevelOperators> const& operators, bool singular,
                     SolverOptions const& options)
    : bottom_(comm, operators.front(), singular) {
  levels_.reserve(operators.size());
  for (auto const& o : operators) levels_.emplace_back(o, options);
}

void Multigrid::cycle(std::size_t l) {
  if (l == 0) {
    stopwatch_.time("bottom", [&] { bottom_.solve(levels_[0].right_hand_side(), levels_[0].correction()); });
  } else {
    stopwatch_.time("pre_smooth_and_restrict", [&] { levels_[l].pre_smooth_and_restrict(levels_[l - 1]); });
    cycle(l - 1);
    stopwatch_.time("prolong_and_post_smooth", [&] { levels_[l].prolong_and_post_smooth(levels_[l - 1]); });
  }
  levels_[l].operators().halo.update(levels_[l].correction().data());
}

}  // namespace amrpic
