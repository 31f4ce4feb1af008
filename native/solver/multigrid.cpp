#include "solver/multigrid.hpp"

#include "solver/copy_cycle.hpp"

namespace amrpic {

MultigridLevel::MultigridLevel(LevelOperators const& operators, std::unique_ptr<Smoother> smoother)
    : operators_(operators),
      smoother_(std::move(smoother)),
      right_hand_side_(operators.cells),
      correction_(operators.cells),
      residual_(operators.cells) {}

std::vector<LevelOperators const*> MultigridLevel::all_operators() const {
  auto out = smoother_ ? smoother_->own_levels() : std::vector<LevelOperators const*>{};
  out.push_back(&operators_);
  return out;
}

void MultigridLevel::restrict_right_hand_side(MultigridLevel& coarser) {
  residual_.assign(right_hand_side_);
  residual_.update_halo();
  coarser.operators_.restriction.set_rows(residual_, coarser.right_hand_side_);
}

void MultigridLevel::pre_smooth_and_restrict(Guess guess, MultigridLevel& coarser) {
  if (guess == Guess::zero) {
    smoother_->smooth_from_zero(right_hand_side_, correction_);
  } else {
    operators_.prolongation.multiply(coarser.correction_, correction_);
    smoother_->smooth(Side::before, right_hand_side_, correction_);
  }
  correction_.update_halo();
  operators_.no_fine.subtract(right_hand_side_, correction_, residual_);
  residual_.update_halo();
  coarser.operators_.restriction.set_rows(residual_, coarser.right_hand_side_);
  coarser.operators_.fine_boundary.add(-1, correction_, coarser.right_hand_side_);
}

void MultigridLevel::prolong_and_post_smooth(MultigridLevel const& coarser) {
  operators_.prolongation.add(1, coarser.correction_, correction_);
  operators_.coarse_boundary.add(-1, coarser.correction_, right_hand_side_);
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
    if (l > 0 && !smoother) smoother = make_smoother(o, multigrid.halves_at_most(l), options);
    levels_.emplace_back(o, std::move(smoother));
  }
}

void Multigrid::cycle() {
  run_cycle(multigrid_levels_,
            {[&](std::size_t l) { levels_[l].restrict_right_hand_side(levels_[l - 1]); },
             [&](std::size_t l, Guess guess) { levels_[l].pre_smooth_and_restrict(guess, levels_[l - 1]); },
             [&](std::size_t l) {
               levels_[l].prolong_and_post_smooth(levels_[l - 1]);
               levels_[l].update_copies();
             },
             [&] {
               bottom_->solve(levels_[0].right_hand_side(), levels_[0].correction());
               levels_[0].update_copies();
             }});
}

}  // namespace amrpic
