#pragma once

#include <algorithm>
#include <cassert>
#include <cstddef>
#include <string>

#include "base/types.hpp"

namespace amrpic {

/// A block of cells of one level; both corners belong to it. Empty if an upper index lies below the lower one.
struct Box {
  Index3 lower{0, 0, 0};
  Index3 upper{-1, -1, -1};

  KOKKOS_INLINE_FUNCTION int extent(int axis) const { return upper[axis] - lower[axis] + 1; }
  bool empty() const { return extent(0) <= 0 || extent(1) <= 0 || extent(2) <= 0; }
  GlobalIndex cells() const { return empty() ? 0 : GlobalIndex(extent(0)) * extent(1) * extent(2); }

  bool contains(Index3 const& cell) const {
    for (int d = 0; d < 3; ++d)
      if (cell[d] < lower[d] || cell[d] > upper[d]) return false;
    return true;
  }
  bool contains(Box const& other) const { return contains(other.lower) && contains(other.upper); }

  /// Place of a cell in this box's memory, x fastest.
  GlobalIndex offset(Index3 const& cell) const {
    assert(contains(cell));
    return (cell[0] - lower[0]) +
           GlobalIndex(extent(0)) * ((cell[1] - lower[1]) + GlobalIndex(extent(1)) * (cell[2] - lower[2]));
  }

  /// The cell at a place.
  Index3 cell_at(GlobalIndex offset) const {
    GlobalIndex const row = offset / extent(0);
    return {lower[0] + int(offset % extent(0)), lower[1] + int(row % extent(1)), lower[2] + int(row / extent(1))};
  }

  /// How far apart the places of neighbours along an axis are.
  KOKKOS_INLINE_FUNCTION std::ptrdiff_t stride(int axis) const {
    return axis == 0 ? 1 : axis == 1 ? extent(0) : std::ptrdiff_t(extent(0)) * extent(1);
  }
  Index3 strides() const { return {int(stride(0)), int(stride(1)), int(stride(2))}; }

  Box intersect(Box const& other) const {
    Box out;
    for (int d = 0; d < 3; ++d) {
      out.lower[d] = std::max(lower[d], other.lower[d]);
      out.upper[d] = std::min(upper[d], other.upper[d]);
    }
    return out;
  }
  /// The smallest box that holds both.
  Box hull(Box const& other) const {
    Box out;
    for (int d = 0; d < 3; ++d) {
      out.lower[d] = std::min(lower[d], other.lower[d]);
      out.upper[d] = std::max(upper[d], other.upper[d]);
    }
    return out;
  }
  Box grow(int n) const { return grow({n, n, n}); }
  Box grow(Index3 const& n) const {
    Box out = *this;
    for (int d = 0; d < 3; ++d) out.lower[d] -= n[d], out.upper[d] += n[d];
    return out;
  }
  Box shift(Index3 const& by) const {
    Box out = *this;
    for (int d = 0; d < 3; ++d) out.lower[d] += by[d], out.upper[d] += by[d];
    return out;
  }
  Box shift_back(Index3 const& by) const { return shift({-by[0], -by[1], -by[2]}); }
  /// The layer of cells inside a face, side 0 or 1 of an axis, or `outwards` layers further.
  Box layer(int axis, int side, int outwards) const {
    Box out = *this;
    out.lower[axis] = out.upper[axis] = side == 0 ? lower[axis] - outwards : upper[axis] + outwards;
    return out;
  }
  /// The same region in cells `ratio` times finer.
  Box refine(Index3 const& ratio) const {
    Box out;
    for (int d = 0; d < 3; ++d) out.lower[d] = lower[d] * ratio[d], out.upper[d] = (upper[d] + 1) * ratio[d] - 1;
    return out;
  }
  /// The smallest region of cells `ratio` times coarser that holds this one.
  Box coarsen(Index3 const& ratio) const {
    Box out;
    for (int d = 0; d < 3; ++d)
      out.lower[d] = floor_divide(lower[d], ratio[d]), out.upper[d] = floor_divide(upper[d], ratio[d]);
    return out;
  }
  bool operator==(Box const& other) const { return lower == other.lower && upper == other.upper; }
};

/// The cell twice as wide that holds a cell, and the lowest of those half as wide in it.
inline Index3 parent_of(Index3 const& cell) {
  return {floor_divide(cell[0], 2), floor_divide(cell[1], 2), floor_divide(cell[2], 2)};
}
inline Index3 first_child_of(Index3 const& cell) { return {2 * cell[0], 2 * cell[1], 2 * cell[2]}; }

/// Call `f(its first cell)` for each row of a box along x, in the order of memory.
template <class F>
void for_each_row(Box const& box, F&& f) {
  for (int k = box.lower[2]; k <= box.upper[2]; ++k)
    for (int j = box.lower[1]; j <= box.upper[1]; ++j) f(Index3{box.lower[0], j, k});
}

/// Call `f(Index3)` for each cell of a box, x fastest.
template <class F>
void for_each_cell(Box const& box, F&& f) {
  for (int k = box.lower[2]; k <= box.upper[2]; ++k)
    for (int j = box.lower[1]; j <= box.upper[1]; ++j)
      for (int i = box.lower[0]; i <= box.upper[0]; ++i) f(Index3{i, j, k});
}

inline std::string to_string(Index3 const& i) {
  return "(" + std::to_string(i[0]) + ", " + std::to_string(i[1]) + ", " + std::to_string(i[2]) + ")";
}
inline std::string to_string(Box const& box) { return to_string(box.lower) + "-" + to_string(box.upper); }

}  // namespace amrpic
