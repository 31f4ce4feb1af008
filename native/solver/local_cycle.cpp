#include "solver/local_cycle.hpp"

#include <algorithm>

namespace amrpic {

namespace {

/// The copies need sweeps on either side of their corrections, whatever the cycle around them does.
SolverOptions on_either_side(SolverOptions options) {
  options.pre_sweeps = std::max(1, options.pre_sweeps);
  options.post_sweeps = std::max(1, options.post_sweeps);
  return options;
}

}  // namespace

LocalCycle::LocalCycle(MPI_Comm comm, LevelOperators const& operators, Index3 const& ratio, CorrectionGhosts ghosts,
                       SolverOptions const& options)
    : operators_(operators),
      points_(make_smoother(comm, operators, on_either_side(options))),
      share_(1.0 / (ratio[0] * ratio[1] * ratio[2])),
      coarse_operators_(semicoarsened(comm, *operators.level, ratio, ghosts)),
      coarse_(make_refined_smoother(comm, coarse_operators_, ghosts, on_either_side(options))),
      coarse_f_(std::size_t(coarse_operators_.rows())),
      coarse_x_(coarse_f_.size() + std::size_t(coarse_operators_.halo.ghosts())) {
  Level const &fine = *operators.level, &coarse = *coarse_operators_.level;
  parent_.reserve(std::size_t(fine.local_cells()));
  for (int b = fine.first_local_box(); b < fine.last_local_box(); ++b)
    for_each_cell(fine.box(b), [&](Index3 const& cell) {
      Index3 const parent = Box{cell, cell}.coarsen(ratio).lower;
      parent_.push_back(coarse.local_offset(b) + LocalIndex(coarse.box(b).offset(parent)));
    });
}

void LocalCycle::smooth_from_zero(std::vector<Real> const& f, std::vector<Real>& x) {
  points_->smooth_from_zero(f, x);
  correct(f, x);
  points_->smooth(f, x);
}

void LocalCycle::smooth(std::vector<Real> const& f, std::vector<Real>& x) {
  points_->smooth(f, x);
  correct(f, x);
  points_->smooth(f, x);
}

std::vector<LevelOperators const*> LocalCycle::own_levels() const {
  auto out = coarse_->own_levels();
  out.push_back(&coarse_operators_);
  return out;
}

/// Add what the coarser copies find for the residual: its mean goes down, the correction comes back to each child.
void LocalCycle::correct(std::vector<Real> const& f, std::vector<Real>& x) {
  operators_.stencil_halo.update(x.data());
  std::fill(coarse_f_.begin(), coarse_f_.end(), 0.0);
  for (std::size_t row = 0; row < parent_.size(); ++row)
    coarse_f_[std::size_t(parent_[row])] += share_ * (f[row] - operators_.no_fine.dot(LocalIndex(row), x.data()));
  coarse_->smooth_from_zero(coarse_f_, coarse_x_);
  for (std::size_t row = 0; row < parent_.size(); ++row) x[row] += coarse_x_[std::size_t(parent_[row])];
}

std::unique_ptr<Smoother> make_refined_smoother(MPI_Comm comm, LevelOperators const& operators,
                                                CorrectionGhosts const& ghosts, SolverOptions const& options) {
  Index3 const ratio = semicoarsening_of(*operators.level);
  if (ratio == Index3{1, 1, 1}) return make_smoother(comm, operators, options);
  return std::make_unique<LocalCycle>(comm, operators, ratio, ghosts, options);
}

}  // namespace amrpic
