#pragma once

#include <array>
#include <cstddef>

#include "base/kokkos.hpp"
#include "base/types.hpp"

namespace amrpic {

enum class Prolongation { constant, trilinear };

/// Along each axis a fine cell's centre lies a quarter of a coarse cell from its parent's, towards one of the parent's
/// neighbours: what linear interpolation takes of either.
namespace prolongation {
constexpr Real near = 3.0 / 4, far = 1.0 / 4;
}

/// A fine value between those of its parent and of the parent's neighbour on its side.
template <class Value>
KOKKOS_INLINE_FUNCTION Value prolonged(Value const& parent, Value const& neighbour) {
  return prolongation::near * parent + prolongation::far * neighbour;
}
/// The same where the neighbour's weight is another.
template <class Weight, class Value>
KOKKOS_INLINE_FUNCTION Value prolonged(Weight far, Value const& parent, Value const& neighbour) {
  return (1 - far) * parent + far * neighbour;
}

/// What each child weighs in its parent's mean.
inline Real mean_weight(Index3 const& ratio) { return 1.0 / (ratio[0] * ratio[1] * ratio[2]); }

/// The mean of eight children, whose first one is `child`, with so much between rows and planes. It is rounded the same
/// wherever it stands in a row.
template <class Value>
KOKKOS_INLINE_FUNCTION Value mean_of_children(Value const* child, std::ptrdiff_t y, std::ptrdiff_t z) {
  return ((child[0] + child[1]) + (child[y] + child[y + 1]) + (child[z] + child[z + 1]) +
          (child[y + z] + child[y + z + 1])) *
         0.125;
}

/// What the mean over the upper or lower half of a cell takes of the means of the cell on the left, of the cell itself
/// and of that on the right, by the parabola with these three means; behind a wall the slope is that towards the other
/// side.
inline std::array<Real, 3> half_cell_weights(bool upper, bool has_left, bool has_right) {
  Real const s = upper ? 1.0 / 8 : -1.0 / 8;
  if (has_left && has_right) return {-s, 1, s};
  if (has_left) return {-2 * s, 1 + 2 * s, 0};
  if (has_right) return {0, 1 - 2 * s, 2 * s};
  return {0, 1, 0};
}

}  // namespace amrpic
