#include "solver/multigrid.hpp"

#include "base/for_rows.hpp"
#include "solver/copy_cycle.hpp"

namespace amrpic {

MultigridLevel::MultigridLevel(LevelOperators const& operators, std::unique_ptr<Smoother> smoother)
    : operators_(operators), smoother_(std::move(smoother)) {
  std::size_t const own = std::size_t(operators.rows()), all = own + std::size_t(operators.halo.size());
  right_hand_side_.resize(own);
  correction_.resize(all);
  residual_.resize(all);
}

std::vector<LevelOperators const*> MultigridLevel::all_operators() const {
  auto out = smoother_ ? smoother_->own_levels() : std::vector<LevelOperators const*>{};
  out.push_back(&operators_);
  return out;
}

void MultigridLevel::restrict_right_hand_side(MultigridLevel& coarser) {
  std::copy(right_hand_side_.begin(), right_hand_side_.end(), residual_.begin());
  operators_.halo.update(residual_.data());
  Crs const& restriction = coarser.operators_.restriction;
  restriction.for_each_row(
      [&](LocalIndex row) { coarser.right_hand_side_[row] = restriction.dot(row, residual_.data()); });
}

void MultigridLevel::pre_smooth_and_restrict(Guess guess, MultigridLevel& coarser) {
  if (guess == Guess::zero) {
    smoother_->smooth_from_zero(right_hand_side_, correction_);
  } else {
    std::fill(correction_.begin(), correction_.end(), 0.0);
    add_multiply(1.0, operators_.prolongation, coarser.correction_.data(), correction_.data());
    smoother_->smooth(Side::before, right_hand_side_, correction_);
  }
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
  smoother_->smooth(Side::after, right_hand_side_, correction_);
}

Multigrid::Multigrid(Communicator const& comm, MultigridLevels const& multigrid, MultigridOperators const& operators,
                     std::shared_ptr<Bottom> bottom, int max_grid_size, SolverOptions const& options)
    : multigrid_levels_(multigrid), bottom_(std::move(bottom)) {
  levels_.reserve(operators.size());
  for (std::size_t l = 0; l < operators.size(); ++l) {
    LevelOperators const& o = *operators[l];
    std::unique_ptr<Smoother> smoother;  // the coarsest level needs none
    if (multigrid.refines(l)) {
      auto const copies = semicoarse_copies(o.level, o.walls, multigrid.boundary, max_grid_size);
      smoother = make_refined_smoother(comm, o, copies, options);
    }
    if (l > 0 && !smoother) smoother = make_smoother(comm, o, multigrid.halves_at_most(l), options);
    levels_.emplace_back(o, std::move(smoother));
  }
}

void Multigrid::cycle(Stopwatch& stopwatch) {
  run_cycle(multigrid_levels_,
            {[&](std::size_t l) {
               stopwatch.time("pre_smooth_and_restrict", [&] { levels_[l].restrict_right_hand_side(levels_[l - 1]); });
             },
             [&](std::size_t l, Guess guess) {
               stopwatch.time("pre_smooth_and_restrict",
                              [&] { levels_[l].pre_smooth_and_restrict(guess, levels_[l - 1]); });
             },
             [&](std::size_t l) {
               stopwatch.time("prolong_and_post_smooth", [&] { levels_[l].prolong_and_post_smooth(levels_[l - 1]); });
               levels_[l].update_copies();
             },
             [&] {
               stopwatch.time("bottom", [&] { bottom_->solve(levels_[0].right_hand_side(), levels_[0].correction()); });
               levels_[0].update_copies();
             }});
}

}  // namespace amrpic
