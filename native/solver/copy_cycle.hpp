#pragma once

#include "base/communicator.hpp"
#include "operators/copy_operators.hpp"
#include "solver/smoother.hpp"

namespace amrpic {

/// Reduces the residual of a refinement level of long or flat cells by a V-cycle over its copies.
///
/// A point smoother reduces no error that is smooth along the axes of small spacing, and the next coarser level, with
/// half the cells along all axes, does not resolve it where it oscillates along the others: cells of 1:1:10 took 100
/// cycles.
class CopyCycle {
 public:
  /// `above`: the operators of the level above the first of the `copies`, which are not empty. Collective.
  CopyCycle(Communicator const& comm, LevelOperators const& above, LevelCopy const* copies, std::size_t count,
            SolverOptions const& options);

  /// Add to x what is found for f - no_fine x. Collective.
  void correct(LevelVector const& f, LevelVector& x);

  /// Operators of the copies, coarsest first.
  std::vector<LevelOperators const*> levels() const;

 private:
  LevelOperators const& above_;
  CopyOperators copy_;
  std::unique_ptr<Smoother> smoother_;
  std::unique_ptr<CopyCycle> next_;
  LevelVector residual_, f_, x_;
};

/// The smoother of a refinement level: the one that the options name, and a cycle over the level's copies where it has
/// any. Collective.
std::unique_ptr<Smoother> make_refined_smoother(Communicator const& comm, LevelOperators const& operators,
                                                std::vector<LevelCopy> const& copies, SolverOptions const& options);

}  // namespace amrpic
