#pragma once

#include "operators/copy_operators.hpp"
#include "solver/smoother.hpp"

namespace amrpic {

/// Smooths a refinement level of long or flat cells by a V-cycle of its own, over the level and copies of it with fewer
/// cells along the axes of small spacing.
///
/// A point smoother reduces no error that is smooth along those axes, and the next coarser level, with half the cells
/// along all axes, does not see it where it oscillates along the others: cells of 1:1:10 took 100 cycles.
class LocalCycle : public Smoother {
 public:
  /// `copies`: from the one below this level on; not empty. Collective.
  LocalCycle(MPI_Comm comm, LevelOperators const& operators, LevelCopy const* copies, std::size_t count,
             SolverOptions const& options);

  void smooth_from_zero(std::vector<Real> const& f, std::vector<Real>& x) override;
  void smooth(Sweeps sweeps, std::vector<Real> const& f, std::vector<Real>& x) override;
  std::vector<LevelOperators const*> own_levels() const override;

 private:
  void correct(std::vector<Real> const& f, std::vector<Real>& x);

  LevelOperators const& operators_;
  std::unique_ptr<Smoother> points_;
  CopyOperators copy_;
  std::unique_ptr<Smoother> coarse_;
  std::vector<Real> residual_, coarse_f_, coarse_x_, values_;
};

/// The smoother of a refinement level: the one that the options name, in a V-cycle of its own where the level has
/// copies. Collective.
std::unique_ptr<Smoother> make_refined_smoother(MPI_Comm comm, LevelOperators const& operators, LevelCopy const* copies,
                                                std::size_t count, SolverOptions const& options);

}  // namespace amrpic
