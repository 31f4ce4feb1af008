// Between covered cells and their eight children.
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

/// Add the values of a row of parents to their children; as above.
inline void add_to_children(int count, Real const* parent, std::ptrdiff_t y, std::ptrdiff_t z, Real* __restrict child) {
  for (int i = 0; i < count; ++i, child += 2)
    for (std::ptrdiff_t row : {std::ptrdiff_t(0), y, z, y + z}) child[row] += parent[i], child[row + 1] += parent[i];
}

}  // namespace amrpic
