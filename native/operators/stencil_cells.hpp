#pragma once

#include "mesh/faces.hpp"
#include "stencil/odd_extents.hpp"

namespace amrpic {

/// The cells that the stencils of a box read: their numbers on the box's own level and on the neighbouring ones.
struct StencilCells {
  Level const* level;
  WallGhosts walls;
  Real3 seam_width;             ///< of last cells along periodic axes, see `UpperEnd`
  ArrayOnBox<CellFaces> faces;  ///< of the box's cells
  ArrayOnBox<GlobalIndex> own;  ///< box grown by 2
  // Empty where no covered cell lies beside an uncovered one:
  ArrayOnBox<char> covered;      ///< by the next finer level, extent of `own`
  ArrayOnBox<GlobalIndex> fine;  ///< children of the box grown by 1
  // Empty where no coarser cell lies beside the box:
  ArrayOnBox<GlobalIndex> coarse;   ///< parents of the box grown by 1, grown by 2
  ArrayOnBox<char> coarse_covered;  ///< by this level, same extent
};

/// Those of a box; `finer` and `coarser` may be null.
inline StencilCells stencil_cells_of(BoxFaces const& faces, Level const& level, Level const* finer,
                                     Level const* coarser, WallGhosts const& walls,
                                     Real3 const& seam_width = {1, 1, 1}) {
  Box const &box = faces.box, wide = box.grow(2), none;
  Box const children = finer && !faces.beside.empty() ? box.grow(1).refine({2, 2, 2}) : none;
  Box const parents = coarser && faces.ends_level() ? box.grow(1).coarsen({2, 2, 2}).grow(2) : none;
  ArrayOnBox<GlobalIndex> const no_numbers(none, no_cell);
  ArrayOnBox<char> const no_flags(none, 0);
  return {&level,
          walls,
          seam_width,
          cell_faces(faces),
          cell_numbers(level, wide),
          children.empty() ? no_flags : covered_cells(*finer, {2, 2, 2}, wide),
          children.empty() ? no_numbers : cell_numbers(*finer, children),
          parents.empty() ? no_numbers : cell_numbers(*coarser, parents),
          parents.empty() ? no_flags : covered_cells(level, {2, 2, 2}, parents)};
}

}  // namespace amrpic
