#pragma once

#include "mesh/array_on_box.hpp"
#include "stencil/odd_extents.hpp"

namespace amrpic {

/// The cells that the stencils of a box read: their numbers on the box's own level and on the neighbouring ones.
struct StencilCells {
  Box domain;
  std::array<bool, 3> periodic;
  Real3 spacing;
  WallGhosts walls;
  Real3 seam_width;                 ///< of last cells along periodic axes, see `UpperEnd`
  ArrayOnBox<GlobalIndex> own;      ///< box grown by 2
  ArrayOnBox<char> covered;         ///< by the next finer level, same extent
  ArrayOnBox<GlobalIndex> fine;     ///< children of the box grown by 1; empty where nothing finer is near
  ArrayOnBox<GlobalIndex> coarse;   ///< parents of the box grown by 1, grown by 2; empty on the base
  ArrayOnBox<char> coarse_covered;  ///< by this level, same extent

  bool behind_wall(Index3 const& cell, int axis) const {
    return !periodic[axis] && (cell[axis] < domain.lower[axis] || cell[axis] > domain.upper[axis]);
  }
};

/// Those of a box; `finer` and `coarser` may be null.
inline StencilCells stencil_cells_of(Box const& box, Level const& level, Level const* finer, Level const* coarser,
                                     WallGhosts const& walls, Real3 const& seam_width = {1, 1, 1}) {
  Box const wide = box.grow(2), none;
  Box const parents = coarser ? box.grow(1).coarsen({2, 2, 2}).grow(2) : none;
  auto covered = finer ? covered_cells(*finer, {2, 2, 2}, wide) : ArrayOnBox<char>(wide, 0);
  bool const near = finer && finer->intersects(box.grow(1).refine({2, 2, 2}));
  return {level.domain(),
          level.periodic(),
          level.spacing(),
          walls,
          seam_width,
          cell_numbers(level, wide),
          std::move(covered),
          near ? cell_numbers(*finer, box.grow(1).refine({2, 2, 2})) : ArrayOnBox<GlobalIndex>(none, no_cell),
          coarser ? cell_numbers(*coarser, parents) : ArrayOnBox<GlobalIndex>(none, no_cell),
          coarser ? covered_cells(level, {2, 2, 2}, parents) : ArrayOnBox<char>(none, 0)};
}

}  // namespace amrpic
