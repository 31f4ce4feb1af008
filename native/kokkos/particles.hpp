#pragma once

#include "particle/tile_kernels.hpp"

namespace amrpic::kokkos {

/// Loops over particles as Kokkos kernels of the default execution space, each over all boxes at hand. Without Kokkos:
/// throws std::invalid_argument.
TileKernels const& tile_kernels();

}  // namespace amrpic::kokkos
