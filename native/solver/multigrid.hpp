#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "base/communicator.hpp"
#include "matrices/semicoarse_operators.hpp"
#include "multigrid/multigrid_cycle.hpp"
#include "solver/bottom.hpp"
#include "solver/options.hpp"
#include "solver/smoother.hpp"

namespace amrpic {

/// One level of the cycle: its operators, what leads to and from the finer level that it corrects, and vectors that are
/// allocated once.
struct MultigridLevel {
  std::shared_ptr<LevelOperators> operators;
  SparseMatrix const* prolongation;     ///< to the finer level; null of the finest
  SparseMatrix const* coarse_boundary;  ///< of the finer level; null of the finest and semicoarsened ones
  std::unique_ptr<Smoother> smoother;   ///< before coarser corrections, and after the first one; none of the coarsest
  std::unique_ptr<Smoother> after;      ///< of the finer level, where this is the second that corrects it
  std::optional<LevelVector> residual;  ///< of the finer level, with what restriction reads
  LevelVector right_hand_side, correction;
};

/// The cycle over refinement levels and multigrid levels (see run_cycle) for corrections in residual form, by products
/// with the operators.
class Multigrid : public CycleActs {
 public:
  /// The operators must outlive it; `metal`: null if there is none. Collective.
  Multigrid(Communicator const& comm, MultigridLevels const& multigrid, MultigridOperators const& operators,
            std::shared_ptr<Bottom> bottom, int max_grid_size, SolverOptions const& options,
            Metal const* metal = nullptr);

  std::vector<MultigridLevel> const& levels() const { return levels_; }
  MultigridLevel& level(std::size_t l) { return levels_[l]; }  ///< as in CycleLevels

  /// The corrections from the finest level down; reads every refinement level's right-hand side. Collective.
  void cycle() { run_cycle(cycle_levels_, *this); }

  void pre_smooth(std::size_t l, Guess guess) override;
  void find_residual(std::size_t l, std::size_t coarser) override;
  void restrict_residual(std::size_t l, std::size_t coarser) override;
  void prolong(std::size_t coarser, std::size_t l) override;
  void post_smooth(std::size_t l, std::size_t coarser) override;
  void solve_coarsest() override;
  void restrict_right_hand_side(std::size_t l) override;

 private:
  CycleLevels cycle_levels_;
  std::vector<SemicoarseOperators> semicoarse_;
  std::vector<MultigridLevel> levels_;
  std::shared_ptr<Bottom> bottom_;
};

}  // namespace amrpic
