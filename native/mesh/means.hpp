// Means of eight children: what a covered cell holds.
#pragma once

#include <cstddef>

#include "stencil/intergrid.hpp"

namespace amrpic {

/// Set a row of parents to the means of their children, whose first one is `child`, with so much between rows and
/// planes. See `mean_of_children`.
inline void average_children(int count, Real const* child, std::ptrdiff_t y, std::ptrdiff_t z,
                             Real* __restrict parent) {
  for (int i = 0; i < count; ++i, child += 2) parent[i] = mean_of_children(child, y, z);
}

}  // namespace amrpic
