#pragma once

#include "operators/open_walls.hpp"
#include "operators/operators.hpp"

namespace amrpic {

/// How multigrid levels are shared by ranks.
struct CoarseBoxes {
  int max_grid_size;      ///< cells of a box along an axis, where boxes are made anew
  GlobalIndex whole = 0;  ///< levels of at most so many cells are held whole by every rank: Levels of one rank
};

/// The stack with multigrid levels put below its base, at most so many in all: each the one above with cells paired
/// along the axes of smallest spacing, whatever their number; the last one has at most 64 cells unless `most` is
/// reached.
///
/// Boxes stay on their ranks while they can be halved with all children of a cell in one box, and while there is enough
/// to do on each rank; else larger ones are made, on fewer ranks as levels shrink.
LevelStack coarsen_below(LevelStack stack, Domain const& domain, CoarseBoxes const& boxes, int most);

/// Boxes in their final order, and where each rank's run of them starts.
struct Shared {
  std::vector<Box> boxes;
  std::vector<int> first;
};

/// A level's boxes halved along some axes, on the same ranks; none if a cell's children would not fill a box, except at
/// the domain's upper end, or would be in two boxes on the next coarser level. `domain`: the coarser one.
Shared halved(Level const& finer, Index3 const& ratio, Box const& domain);

/// Sort boxes along the curve, and share them by cells among the first `active` ranks: where each rank's run starts.
std::vector<int> share_along_curve(std::vector<Box>& boxes, int ranks, int active);

/// Factor of the last cell in the ghost behind a wall that prolongation from level l reads.
Real prolonged_end(LevelStack const& stack, OpenWalls const& open_walls, std::size_t l, Index3 const& cell, int axis,
                   int side);

/// What the children of a level's cells weigh at the upper ends of a level `finer`; see `last_children`.
std::array<LastChildren, 3> last_children_of(LevelStack const& stack, std::size_t finer);

}  // namespace amrpic
