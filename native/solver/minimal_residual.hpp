#pragma once

#include <deque>
#include <functional>
#include <utility>
#include <vector>

#include "matrixfree/memory.hpp"

namespace amrpic {

/// Corrections of cycles that converge slowly, combined for the least residual in the 2-norm: generalised conjugate
/// residuals (Eisenstat, Elman and Schultz, SIAM J. Numer. Anal. 20, 345, 1983) with a cycle as flexible preconditioner
/// and the latest few directions. Few outlying errors cost cycles their rate, such as those that a coarser level
/// overshoots in beside a refined one; they are gone after as many steps.
class MinimalResidual {
 public:
  using Vectors = std::vector<matrixfree::Vector>;  ///< [level]
  using Dot = std::function<Real(Vectors const&, Vectors const&)>;

  void clear() { kept_.clear(); }

  /// Of a correction, the residual before it and the residual after it: make of the correction what is still to be
  /// added for the least residual. `dot` is that over own uncovered cells of all ranks. Collective.
  void improve(Vectors& correction, Vectors const& before, Vectors const& after, Dot const& dot) {
    Vectors direction = correction, image = before;
    add(-1, after, image);
    for (auto const& old : kept_) {
      Real const common = dot(image, old.image) / old.size;
      add(-common, old.direction, direction);
      add(-common, old.image, image);
    }
    Real const size = dot(image, image), step = size > 0 ? dot(before, image) / size : 1;
    for (std::size_t l = 0; l < correction.size(); ++l)
      for (std::size_t i = 0; i < correction[l].size(); ++i)
        correction[l][i] = float(step) * direction[l][i] - correction[l][i];
    if (!(size > 0)) return;
    if (kept_.size() == most_directions) kept_.pop_front();
    kept_.push_back({std::move(direction), std::move(image), size});
  }

 private:
  static constexpr std::size_t most_directions = 4;
  struct Direction {
    Vectors direction, image;  ///< of the potential, and what it takes from the residual
    Real size;                 ///< of the image, squared
  };
  static void add(Real factor, Vectors const& from, Vectors& to) {
    for (std::size_t l = 0; l < to.size(); ++l)
      for (std::size_t i = 0; i < to[l].size(); ++i) to[l][i] += float(factor) * from[l][i];
  }
  std::deque<Direction> kept_;
};

}  // namespace amrpic
