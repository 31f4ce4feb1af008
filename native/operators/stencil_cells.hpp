#pragma once

#include <memory>

#include "mesh/faces.hpp"
#include "stencil/odd_extents.hpp"

namespace amrpic {

/// Whether rows are made as if nothing finer existed, or those of the composite operator.
enum class Execution { without_finer, composite };

/// More cells, that stencils of boxes with narrow gaps beside them read.
struct CellsAroundGaps {
  ArrayOnBox<GlobalIndex> own;    ///< box grown by 4
  ArrayOnBox<char> covered;       ///< by the next finer level, same extent
  ArrayOnBox<char> fine_covered;  ///< children of the box grown by 1, covered by the level after the next finer one
};

/// The cells that the stencils of a box read: their numbers on the box's own level and on the neighbouring ones.
struct StencilCells {
  Level const* level;
  Level const* finer;           ///< may be null, as the next one
  Level const* finest;          ///< the next finer one than `finer`
  Real3 seam_width;             ///< of last cells along periodic axes, see `UpperEnd`
  ArrayOnBox<CellFaces> faces;  ///< of the box's cells
  // Empty where no covered cell lies beside an uncovered one:
  ArrayOnBox<GlobalIndex> own;   ///< box grown by 2
  ArrayOnBox<char> covered;      ///< by the next finer level, same extent
  ArrayOnBox<GlobalIndex> fine;  ///< children of the box grown by 1
  // Empty where no coarser cell lies beside the box:
  ArrayOnBox<GlobalIndex> coarse;   ///< parents of the box grown by 1, grown by 2
  ArrayOnBox<char> coarse_covered;  ///< by this level, same extent

  /// Made when they are asked for.
  CellsAroundGaps const& around_gaps() const {
    if (!around_gaps_) {
      Box const &box = faces.box(), wide = box.grow(4), children = box.grow(1).refine({2, 2, 2});
      around_gaps_.reset(new CellsAroundGaps{
          cell_numbers(*level, wide), finer ? covered_cells(*finer, {2, 2, 2}, wide) : ArrayOnBox<char>(wide, 0),
          finest ? covered_cells(*finest, {2, 2, 2}, children) : ArrayOnBox<char>(children, 0)});
    }
    return *around_gaps_;
  }
  /// Where the cells of the level lie that rows read so far.
  Box own_box() const { return around_gaps_ ? around_gaps_->own.box() : faces.box().grow(2); }

  mutable std::shared_ptr<CellsAroundGaps const> around_gaps_ = nullptr;
};

/// Refinement levels beside a level; null where there are none.
struct LevelsBeside {
  Level const *coarser, *finer, *finest;  ///< the last one is the next finer one than `finer`
};

/// The cells of a box.
inline StencilCells stencil_cells_of(BoxFaces const& faces, Level const& level, LevelsBeside const& beside,
                                     Real3 const& seam_width = {1, 1, 1}) {
  auto const [coarser, finer, finest] = beside;
  Box const &box = faces.box, wide = box.grow(2), none;
  bool const has_finer = finer && !faces.beside.empty(), has_coarser = coarser && faces.ends_level();
  Box const parents = has_coarser ? box.grow(1).coarsen({2, 2, 2}).grow(2) : none;
  ArrayOnBox<GlobalIndex> const no_numbers(none, no_cell);
  ArrayOnBox<char> const no_flags(none, 0);
  return {&level,
          finer,
          finest,
          seam_width,
          cell_faces(faces),
          has_finer ? cell_numbers(level, wide) : no_numbers,
          has_finer ? covered_cells(*finer, {2, 2, 2}, wide) : no_flags,
          has_finer ? cell_numbers(*finer, box.grow(1).refine({2, 2, 2})) : no_numbers,
          has_coarser ? cell_numbers(*coarser, parents) : no_numbers,
          has_coarser ? covered_cells(level, {2, 2, 2}, parents) : no_flags};
}

}  // namespace amrpic
