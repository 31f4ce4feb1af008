#include "solver/local_cycle.hpp"

#include <algorithm>

#include "base/rows.hpp"

namespace amrpic {

namespace {

/// The copies need sweeps on either side of their corrections, whatever the cycle around them does.
SolverOptions on_either_side(SolverOptions options) {
  options.pre_sweeps = std::max(1, options.pre_sweeps);
  options.post_sweeps = std::max(1, options.post_sweeps);
  return options;
}

}  // namespace

LocalCycle::LocalCycle(MPI_Comm comm, LevelOperators const& operators, LevelCopy const* copies, std::size_t count,
                       SolverOptions const& options)
    : operators_(operators),
      points_(make_smoother(comm, operators, true, on_either_side(options))),
      copy_(copy_operators(comm, *operators.level, *copies)),
      coarse_(make_refined_smoother(comm, copy_.level, copies + 1, count - 1, on_either_side(options))),
      residual_(std::size_t(operators.rows()) + std::size_t(copy_.above.ghosts())),
      coarse_f_(std::size_t(copy_.level.rows())),
      coarse_x_(coarse_f_.size() + std::size_t(copy_.level.halo.ghosts())),
      values_(coarse_f_.size() + std::size_t(copy_.own.ghosts())) {}

void LocalCycle::smooth_from_zero(std::vector<Real> const& f, std::vector<Real>& x) {
  points_->smooth_from_zero(f, x);
  correct(f, x);
  points_->smooth(Sweeps::after, f, x);
}

void LocalCycle::smooth(Sweeps sweeps, std::vector<Real> const& f, std::vector<Real>& x) {
  points_->smooth(sweeps, f, x);
  correct(f, x);
  points_->smooth(Sweeps::after, f, x);
}

std::vector<LevelOperators const*> LocalCycle::own_levels() const {
  auto out = coarse_->own_levels();
  out.push_back(&copy_.level);
  return out;
}

/// Add what the coarser copies find for the residual.
void LocalCycle::correct(std::vector<Real> const& f, std::vector<Real>& x) {
  operators_.stencil_halo.update(x.data());
  for_rows(operators_.rows(), [&](LocalIndex row) { residual_[row] = f[row] - operators_.no_fine.dot(row, x.data()); });
  copy_.above.update(residual_.data());
  multiply(copy_.restriction, residual_.data(), coarse_f_.data());
  coarse_->smooth_from_zero(coarse_f_, coarse_x_);
  std::copy_n(coarse_x_.begin(), coarse_f_.size(), values_.begin());
  copy_.own.update(values_.data());
  add_multiply(1.0, copy_.prolongation, values_.data(), x.data());
}

std::unique_ptr<Smoother> make_refined_smoother(MPI_Comm comm, LevelOperators const& operators, LevelCopy const* copies,
                                                std::size_t count, SolverOptions const& options) {
  if (count == 0) return make_smoother(comm, operators, true, options);
  return std::make_unique<LocalCycle>(comm, operators, copies, count, options);
}

}  // namespace amrpic
