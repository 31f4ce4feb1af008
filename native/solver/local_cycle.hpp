#pragma once

#include "operators/semicoarse.hpp"
#include "solver/smoother.hpp"

namespace amrpic {

/// Smooths a refinement level of long or flat cells by a V-cycle of its own, over the level and copies of it with fewer
/// cells along the axes of small spacing.
///
/// A point smoother reduces no error that is smooth along those axes, and the next coarser level, with half the cells
/// along all axes, does not see it where it oscillates along the others: cells of 1:1:10 took 100 cycles.
class LocalCycle : public Smoother {
 public:
  /// Collective. `ratio` is not all ones.
  LocalCycle(MPI_Comm comm, LevelOperators const& operators, Index3 const& ratio, CorrectionGhosts ghosts,
             SolverOptions const& options);

  void smooth_from_zero(std::vector<Real> const& f, std::vector<Real>& x) override;
  void smooth(std::vector<Real> const& f, std::vector<Real>& x) override;
  std::vector<LevelOperators const*> own_levels() const override;

 private:
  void correct(std::vector<Real> const& f, std::vector<Real>& x);

  LevelOperators const& operators_;
  std::unique_ptr<Smoother> points_;
  std::vector<LocalIndex> parent_;  ///< of each own cell, on the semi-coarsened level
  Real share_;                      ///< of a cell in the mean over its parent's children
  LevelOperators coarse_operators_;
  std::unique_ptr<Smoother> coarse_;
  std::vector<Real> coarse_f_, coarse_x_;
};

/// The smoother of a refinement level: the one that the options name, in a V-cycle of its own where cells are long or
/// flat. Collective.
std::unique_ptr<Smoother> make_refined_smoother(MPI_Comm comm, LevelOperators const& operators,
                                                CorrectionGhosts const& ghosts, SolverOptions const& options);

}  // namespace amrpic
