#pragma once

#include "stencil/cloud.hpp"

namespace amrpic {

/// The clouds of all particles. Deposit and gather must be given the same.
struct Clouds {
  Shape shape = Shape::cloud_in_cell;
  bool matched = false;  ///< in the buffer zone inside coarse-fine faces, clouds of the coarser level
};

}  // namespace amrpic
