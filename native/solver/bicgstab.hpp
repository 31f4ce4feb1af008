#pragma once

#include <functional>
#include <vector>

#include "matrices/level_cells.hpp"

namespace amrpic {

/// Values of all levels.
using CompositeVector = std::vector<LevelVector>;

/// What an acceleration needs of the equations r = f - A x over all uncovered cells.
struct CompositeEquations {
  std::function<CompositeVector()> zero;  ///< fresh values
  /// out = A x; fills x in covered cells and the halo.
  std::function<void(CompositeVector& x, CompositeVector& out)> multiply;
};

/// BiCGStab (van der Vorst), two cycles to an iteration, with one cycle as its right preconditioner.
///
/// Every cycle ends with a new approximation, whose true residual the caller computes and hands in: so cycles,
/// residual history and rounding floor mean what they mean for the cycles by themselves.
class BiCgStab {
 public:
  explicit BiCgStab(CompositeEquations equations);

  /// Forget what was found for other right-hand sides.
  void restart() { started_ = half_ = false; }

  /// Given the residual of the approximation, zero in covered cells, return what the next cycle is applied to.
  /// Collective.
  CompositeVector const& direction(CompositeVector const& residual);

  /// Given the cycle's correction, return what to add to the approximation. Collective.
  CompositeVector const& step(CompositeVector const& correction);

 private:
  CompositeEquations equations_;
  bool started_ = false;
  bool half_ = false;  ///< the next cycle is the second one of an iteration
  Real product_ = 1, alpha_ = 1, omega_ = 1;
  CompositeVector residual_, shadow_, search_, image_, half_image_, step_;
};

}  // namespace amrpic
