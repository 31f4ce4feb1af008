#pragma once

#include <string>

#include "stencil/intergrid.hpp"

namespace amrpic {

enum class Norm { l1, l2, max };

/// What a solver is asked to do; the reasons for the defaults stand beside them.
struct SolverOptions {
  Real tolerance = 1e-10;  ///< residual over right-hand side, in `norm`
  Norm norm = Norm::max;
  int max_cycles = 100;
  int pre_sweeps = 2, post_sweeps = 2;
  Real relaxation = 1.25;  ///< of red-black Gauss-Seidel; within a cycle of the best for all cases measured
  Prolongation prolongation = Prolongation::trilinear;
  Real3 stretch{1, 1, 1};  ///< factors on the lengths: (1, 1, gamma) is the frame of a bunch that moves along z
  bool neutralize =
      false;  ///< take the mean of the charge away where the boundary leaves the potential's constant free
};

}  // namespace amrpic
