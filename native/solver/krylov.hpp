#pragma once

#include <functional>
#include <memory>
#include <vector>

#include "operators/level_cells.hpp"
#include "solver/options.hpp"

namespace amrpic {

/// Values of all levels.
using CompositeVector = std::vector<LevelVector>;

/// What an acceleration needs of the equations r = f - A x over all uncovered cells.
struct CompositeEquations {
  std::function<CompositeVector()> zero;  ///< fresh values
  /// out = A x; fills x in covered cells and the halo.
  std::function<void(CompositeVector& x, CompositeVector& out)> multiply;
  std::function<Real(CompositeVector const&, CompositeVector const&)> dot;  ///< over uncovered cells of all ranks
};

/// Krylov iteration with one cycle as its right preconditioner, which may change from one cycle to the next.
///
/// Every cycle ends with a new approximation, whose true residual the caller computes and hands in: so cycles,
/// residual history and rounding floor mean what they mean for the cycles by themselves.
class Krylov {
 public:
  virtual ~Krylov() = default;

  /// Given the residual of the approximation, return what the next cycle is applied to. Collective.
  virtual CompositeVector const& direction(CompositeVector const& residual) = 0;

  /// Given the cycle's correction, return what to add to the approximation. Collective.
  virtual CompositeVector const& step(CompositeVector const& correction) = 0;
};

/// Null if nothing is to be accelerated.
std::unique_ptr<Krylov> make_krylov(KrylovKind kind, CompositeEquations equations);

}  // namespace amrpic
