#include "operators/multigrid_cycle.hpp"

namespace amrpic {

namespace {

void v_cycle(CycleSteps const& steps, std::size_t l, Guess guess) {
  if (l == 0) return steps.solve_coarsest();
  steps.pre_smooth_and_restrict(l, guess);
  v_cycle(steps, l - 1, Guess::zero);
  steps.prolong_and_post_smooth(l);
}

void f_cycle(CycleSteps const& steps, std::size_t finest) {
  for (std::size_t l = finest; l > 0; --l) steps.restrict_right_hand_side(l);
  steps.solve_coarsest();
  for (std::size_t l = 1; l <= finest; ++l) v_cycle(steps, l, Guess::coarser);
}

}  // namespace

void run_cycle(MultigridLevels const& multigrid, CycleSteps const& steps) {
  std::size_t const finest = multigrid.levels.size() - 1;
  std::size_t l = finest;
  for (; multigrid.halves_at_most(l); --l) steps.pre_smooth_and_restrict(l, Guess::zero);
  f_cycle(steps, l);
  while (l < finest) steps.prolong_and_post_smooth(++l);
}

}  // namespace amrpic
