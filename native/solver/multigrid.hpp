#pragma once

#include <memory>
#include <vector>

#include "base/communicator.hpp"
#include "operators/multigrid_cycle.hpp"
#include "solver/bottom.hpp"
#include "solver/options.hpp"
#include "solver/smoother.hpp"

namespace amrpic {

/// One level of the cycle: its operators, and vectors that are allocated once.
class MultigridLevel {
 public:
  /// The coarsest level needs no smoother.
  MultigridLevel(LevelOperators const& operators, std::unique_ptr<Smoother> smoother);

  /// Leave the mean of the right-hand side on the coarser level, of which nothing is uncovered. Collective.
  void restrict_right_hand_side(MultigridLevel& coarser);

  /// Smooth the guess, then leave the right-hand side of the coarser level. Collective.
  ///
  /// Covered coarse cells receive the mean of the remaining residual; uncovered ones beside this level lose what the
  /// correction sends through the common faces.
  void pre_smooth_and_restrict(Guess guess, MultigridLevel& coarser);

  /// Add the coarser level's correction, take its part of the ghosts into account, smooth. Collective.
  void prolong_and_post_smooth(MultigridLevel const& coarser);

  /// Bring the correction's copies of other ranks' cells up to date. Collective.
  void update_copies() { correction_.update_halo(); }

  LevelOperators const& operators() const { return operators_; }
  /// Operators of this level and of those that its smoother has for itself.
  std::vector<LevelOperators const*> all_operators() const;
  LevelVector& right_hand_side() { return right_hand_side_; }
  LevelVector& correction() { return correction_; }

 private:
  LevelOperators const& operators_;
  std::unique_ptr<Smoother> smoother_;
  LevelVector right_hand_side_, correction_, residual_;
};

/// The cycle over refinement levels and multigrid levels (see run_cycle) for corrections in residual form.
class Multigrid {
 public:
  /// The levels must outlive it. Collective.
  Multigrid(Communicator const& comm, MultigridLevels const& multigrid, MultigridOperators const& operators,
            std::shared_ptr<Bottom> bottom, int max_grid_size, SolverOptions const& options);

  std::vector<MultigridLevel> const& levels() const { return levels_; }
  MultigridLevel& level(std::size_t l) { return levels_[l]; }  ///< coarse to fine

  /// The corrections from the finest level down; reads every refinement level's right-hand side. Collective.
  void cycle();

 private:
  MultigridLevels const& multigrid_levels_;
  std::vector<MultigridLevel> levels_;
  std::shared_ptr<Bottom> bottom_;
};

}  // namespace amrpic
