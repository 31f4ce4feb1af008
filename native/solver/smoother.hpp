#pragma once

#include <memory>

#include "matrices/operators.hpp"
#include "mesh/metal.hpp"
#include "solver/options.hpp"

namespace amrpic {

enum class Side { before, after };  ///< of the coarse correction

/// Damps those errors of a level that the next coarser one cannot resolve, in no_fine x = f. Only own cells of the
/// result are valid.
class Smoother {
 public:
  virtual ~Smoother() = default;

  /// x from zero, by the sweeps before the coarse correction. Collective.
  virtual void smooth_from_zero(LevelVector const& f, LevelVector& x) = 0;

  /// x from its present values, by the sweeps before or after the coarse correction. Collective.
  virtual void smooth(Side side, LevelVector const& f, LevelVector& x) = 0;
};

/// The smoother that the options name, for a level whose operators outlive it; `v_cycle`: whether it is
/// part of a V-cycle, see relaxation_on; `metal`: in own cells, null if there is none on any rank. Sweeps over all
/// cells that do not start from zero come after one over those beside metal, with red_black. Collective.
std::unique_ptr<Smoother> make_smoother(LevelOperators const& operators, bool v_cycle, SolverOptions const& options,
                                        MetalCells const* metal);

}  // namespace amrpic
