// Means of eight children: what a covered cell holds.
#pragma once

#include <cstddef>

#include "base/types.hpp"

namespace amrpic {

/// Set a row of parents to the means of their children, whose first one is `child`, with so much between rows and
/// planes. Each mean rounds alike wherever it stands in a row.
inline void average_children(int count, Real const* child, std::ptrdiff_t y, std::ptrdiff_t z,
                             Real* __restrict parent) {
  for (int i = 0; i < count; ++i, child += 2)
    parent[i] = ((child[0] + child[1]) + (child[y] + child[y + 1]) + (child[z] + child[z + 1]) +
                 (child[y + z] + child[y + z + 1])) *
                0.125;
}

}  // namespace amrpic
