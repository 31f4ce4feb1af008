#pragma once

#include "multigrid/semicoarse.hpp"

namespace amrpic {

enum class Guess { zero, coarser };  ///< what a level's sweeps start from: nothing, or the coarser level's correction

/// The acts of a cycle, as an execution has them, on levels as CycleLevels numbers them. An execution may put off what
/// it smooths and prolongs until it is read, so as to pass over a level once. All are collective.
class CycleActs {
 public:
  virtual ~CycleActs() = default;

  /// Smooth the correction of level l.
  virtual void pre_smooth(std::size_t l, Guess guess) = 0;
  /// Have its residual, or all that this is evaluated from where it is restricted.
  virtual void find_residual(std::size_t l, std::size_t coarser) = 0;
  /// Leave the right-hand side of a coarser level: parents receive the mean of the residual; uncovered cells beside
  /// level l lose what its correction sends through the common faces.
  virtual void restrict_residual(std::size_t l, std::size_t coarser) = 0;
  /// Add a coarser level's correction to that of level l, and take its part of the ghosts into account.
  virtual void prolong(std::size_t coarser, std::size_t l) = 0;
  /// Smooth the correction of level l after that of a coarser one.
  virtual void post_smooth(std::size_t l, std::size_t coarser) = 0;

  virtual void solve_coarsest() = 0;
  /// Leave the mean of the right-hand side of level l on the next coarser one, of which nothing is uncovered.
  virtual void restrict_right_hand_side(std::size_t l) = 0;
};

/// One cycle for the corrections of all levels, by any execution: a V-cycle over the refinement levels, and from the
/// base down an F-cycle, as soon as levels have at most a quarter of the cells of the next finer one. There the
/// coarsest level is solved first, and each level above starts from what is interpolated from below.
///
/// The F-cycle costs a third more than a V-cycle. On one level it leaves 0.003 of the residual where that leaves 0.02,
/// on nested ones 0.015 where that leaves 0.035. Collective.
void run_cycle(CycleLevels const& levels, CycleActs& acts);

}  // namespace amrpic
