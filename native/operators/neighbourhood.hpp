#pragma once

#include "mesh/window.hpp"
#include "stencil/coarse_end.hpp"

namespace amrpic {

/// What the stencils of a box see of the mesh: the numbers of the cells around it on its own and the neighbouring
/// levels.
struct Neighbourhood {
  Box domain;
  std::array<bool, 3> periodic;
  Real3 spacing;
  WallGhosts walls;
  Real3 seam_width;             ///< of last cells along periodic axes, see `UpperEnd`
  Window<GlobalIndex> own;      ///< box grown by 2
  Window<char> covered;         ///< by the next finer level, same extent
  Window<GlobalIndex> fine;     ///< children of the box grown by 1; empty where nothing finer is near
  Window<GlobalIndex> coarse;   ///< parents of the box grown by 1, grown by 2; empty on the base
  Window<char> coarse_covered;  ///< by this level, same extent

  bool behind_wall(Index3 const& cell, int axis) const {
    return !periodic[axis] && (cell[axis] < domain.lower[axis] || cell[axis] > domain.upper[axis]);
  }
};

/// The neighbourhood of a box; `finer` and `coarser` may be null.
inline Neighbourhood look_around(Box const& box, Level const& level, Level const* finer, Level const* coarser,
                                 WallGhosts const& walls, Real3 const& seam_width = {1, 1, 1}) {
  Box const wide = box.grow(2), none;
  Box const parents = coarser ? box.grow(1).coarsen({2, 2, 2}).grow(2) : none;
  auto covered = finer ? covered_cells(*finer, {2, 2, 2}, wide) : Window<char>(wide, 0);
  bool const near = finer && finer->intersects(box.grow(1).refine({2, 2, 2}));
  return {level.domain(),
          level.periodic(),
          level.spacing(),
          walls,
          seam_width,
          cell_numbers(level, wide),
          std::move(covered),
          near ? cell_numbers(*finer, box.grow(1).refine({2, 2, 2})) : Window<GlobalIndex>(none, no_cell),
          coarser ? cell_numbers(*coarser, parents) : Window<GlobalIndex>(none, no_cell),
          coarser ? covered_cells(level, {2, 2, 2}, parents) : Window<char>(none, 0)};
}

}  // namespace amrpic
