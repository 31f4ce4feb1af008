#pragma once

#include "stencil/cloud.hpp"

namespace amrpic {

class TileKernels;

/// The clouds of all particles, and what executes deposit and gather. Both must be given the same clouds.
struct Clouds {
  Shape shape = Shape::cloud_in_cell;
  bool matched = false;                  ///< in the buffer zone inside coarse-fine faces, clouds of the coarser level
  TileKernels const* kernels = nullptr;  ///< null: loops over vectors of the processor
};

}  // namespace amrpic
