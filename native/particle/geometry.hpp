// How the ghost cells of a box are visited and paired with their parents. The part of a cloud that overhangs a wall is
// folded onto the wall cell, and the field there is that of the wall cell: see `Level::fold_at_walls`.
#pragma once

#include "mesh/level.hpp"
#include "stencil/intergrid.hpp"

namespace amrpic {

/// Layers of ghost cells that the clouds of a box's particles can touch; cloud shapes of a larger reach need wider
/// nesting.
constexpr int tile_reach = 1;

/// Call `f(first, last, j)` for each row part in plane k of `box` grown by `reach` that lies outside `box`, x ascending
/// fastest.
template <class F>
void for_each_ghost_row(Box const& box, int k, F&& f, int reach = tile_reach) {
  Box const tile = box.grow(reach);
  for (int j = tile.lower[1]; j <= tile.upper[1]; ++j) {
    if (j >= box.lower[1] && j <= box.upper[1] && k >= box.lower[2] && k <= box.upper[2]) {
      f(tile.lower[0], box.lower[0] - 1, j);
      f(box.upper[0] + 1, tile.upper[0], j);
    } else {
      f(tile.lower[0], tile.upper[0], j);
    }
  }
}

/// Call `f(first, last, j, k)` for those of all planes, ascending.
template <class F>
void for_each_ghost_row(Box const& box, F&& f, int reach = tile_reach) {
  for (int k = box.lower[2] - reach; k <= box.upper[2] + reach; ++k)
    for_each_ghost_row(
        box, k, [&](int first, int last, int j) { f(first, last, j, k); }, reach);
}

/// Number of ghost cells in the planes below plane k.
inline std::size_t ghost_cells_below(Box const& box, int k) {
  Box below = box.grow(tile_reach);
  below.upper[2] = k - 1;
  return std::size_t(below.cells() - below.intersect(box).cells());
}

/// Along each axis, the neighbour of a cell's parent on the side where the cell lies.
inline Index3 nearest_other_parent(Index3 const& cell) {
  Index3 out = parent_of(cell);
  for (int d = 0; d < 3; ++d) out[d] += 2 * out[d] == cell[d] ? -1 : 1;
  return out;
}

/// Call f(coarse cell, weight) for the eight cells of the next coarser level between whose centres that of `cell` lies.
template <class F>
void for_each_coarse_around(Index3 const& cell, F&& f) {
  Index3 const near = parent_of(cell), far = nearest_other_parent(cell);
  for (int corner = 0; corner < 8; ++corner) {
    Real weight = 1;
    Index3 from;
    for (int d = 0; d < 3; ++d) {
      bool const is_far = (corner >> d) & 1;
      weight *= is_far ? prolongation::far : prolongation::near;
      from[d] = is_far ? far[d] : near[d];
    }
    f(from, weight);
  }
}

}  // namespace amrpic
