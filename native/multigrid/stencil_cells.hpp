#pragma once

#include <memory>

#include "mesh/fits_behind.hpp"
#include "mesh/hierarchy.hpp"
#include "stencil/odd_extents.hpp"

namespace amrpic {

/// Whether rows are made as if nothing finer existed, or those of the composite operator.
enum class Execution { without_finer, composite };

/// Refinement levels beside a level; null where there are none.
struct LevelsBeside {
  Level const *coarser, *finer, *finest;  ///< the last one is the next finer one than `finer`
};

/// The cells that the stencils of a box read, on the box's own level and on the neighbouring ones.
struct StencilCells {
  Level const* level;
  LevelsBeside beside;
  Real3 seam_width;             ///< of last cells along periodic axes, see `UpperEnd`
  ArrayOnBox<CellFaces> faces;  ///< of the box's cells
  // Empty where no covered cell lies beside an uncovered one:
  ArrayOnBox<char> usable;  ///< box grown by 2, see `usable_cells`
  Box children;             ///< of the box grown by 1
  // Empty where no coarser cell lies beside the box:
  ArrayOnBox<char> coarse_usable;  ///< parents of the box grown by 1, grown by 2

  // The cells around gaps behind the box's faces, and around its own cells behind finer boxes' faces. Made when they
  // are asked for.
  GapCells const& gaps_behind() const {
    return made(behind_, *level, *beside.coarser, coarse_usable.box(), beside.finer);
  }
  GapCells const& gaps_before() const { return made(before_, *beside.finer, *level, usable.box(), beside.finest); }

  /// Where the cells of the level lie that rows read so far: fits in gaps reach further.
  Box own_box() const { return faces.box().grow(behind_ ? 4 : 2); }

  mutable std::shared_ptr<GapCells const> behind_ = nullptr, before_ = nullptr;

 private:
  static GapCells const& made(std::shared_ptr<GapCells const>& cells, Level const& fine, Level const& coarse,
                              Box const& region, Level const* finest) {
    if (!cells)
      cells = std::make_shared<GapCells const>(fine, region, overlaps(coarse, region),
                                               overlaps(fine, region.refine(refinement_ratio)), finest);
    return *cells;
  }
};

/// The cells of a box.
inline StencilCells stencil_cells_of(BoxFaces const& faces, Level const& level, LevelsBeside const& beside,
                                     Real3 const& seam_width = {1, 1, 1}) {
  auto const usable = [](Level const& coarse, Level const& fine, Box const& region) {
    return usable_cells(region, overlaps(coarse, region), overlaps(fine, region.refine(refinement_ratio)));
  };
  ArrayOnBox<char> const none(Box{}, 0);
  bool const has_finer = beside.finer && !faces.beside.empty(), has_coarser = beside.coarser && faces.ends_level();
  return {&level,
          beside,
          seam_width,
          cell_faces(faces),
          has_finer ? usable(level, *beside.finer, faces.box.grow(2)) : none,
          has_finer ? faces.box.grow(1).refine(refinement_ratio) : Box{},
          has_coarser ? usable(*beside.coarser, level, faces.box.grow(1).coarsen(refinement_ratio).grow(2)) : none};
}

}  // namespace amrpic
