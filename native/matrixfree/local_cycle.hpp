#pragma once

#include <memory>

#include "base/communicator.hpp"
#include "matrixfree/coarsening.hpp"
#include "operators/semicoarse.hpp"

namespace amrpic::kokkos {
class Cycle;  // the same on Kokkos, by the same lists
}

namespace amrpic::matrixfree {

/// Smooths a refinement level of long or flat cells by a V-cycle of its own, over copies of the level with fewer cells
/// along the axes of small spacing.
///
/// A point smoother reduces no error that is smooth along those axes, and the next coarser level, with half the cells
/// along all axes, does not resolve it where it oscillates along the others.
class LocalCycle {
 public:
  /// `fine` is relaxed by the caller; `shift`: of the Equation. Collective.
  LocalCycle(Communicator const& comm, SweptLevel& fine, LevelCopy const& copy, Faces const& boundary, Real shift,
             Relaxation const& relaxation);

  /// Run stages over the finer level, find a correction for what they leave, and return stages that add it and smooth.
  /// Collective.
  std::vector<PlaneStage> improve(std::vector<PlaneStage> const& stages);

  void rehearse(SweepWork* work);  ///< on all copies, see SweptLevel

  std::unique_ptr<LocalCycle>& next() { return next_; }
  SweptLevel& swept() { return swept_; }
  std::size_t bytes() const { return swept_.bytes() + coarsening_.bytes() + (next_ ? next_->bytes() : 0); }

 private:
  friend class kokkos::Cycle;
  SweptLevel& fine_;
  Relaxation relaxation_;
  SweptLevel swept_;
  Coarsening coarsening_;
  std::unique_ptr<LocalCycle> next_;
};

/// The local cycle of a refinement level over its copies; null without any. Collective.
std::unique_ptr<LocalCycle> make_local_cycle(Communicator const& comm, SweptLevel& fine,
                                             std::vector<LevelCopy> const& copies, Faces const& boundary, Real shift,
                                             Relaxation const& relaxation);

}  // namespace amrpic::matrixfree
