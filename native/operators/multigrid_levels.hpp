#pragma once

#include "operators/open_walls.hpp"
#include "operators/operators.hpp"

namespace amrpic {

/// How multigrid levels are distributed over ranks.
struct CoarseBoxes {
  int max_grid_size;      ///< cells of a box along an axis, where new boxes are cut
  GlobalIndex whole = 0;  ///< every rank stores levels of at most so many cells whole: Levels of one rank
};

/// The levels with coarser ones below the base, at most `most` in all. Each pairs the cells of the next finer one along
/// the axes of smallest spacing, whatever their number; the coarsest has at most 64 cells unless `most` is reached.
///
/// Boxes stay on their ranks while they can be halved with all children of a cell in one box, and while there are 8^3
/// cells per rank; below that those of 8 ranks after each other come together on the first of them. Where boxes cannot
/// be halved new ones are made.
MultigridLevels coarsen_below(MultigridLevels multigrid, Domain const& domain, CoarseBoxes const& boxes, int most);

/// Boxes in their final order, and where each rank's run of them starts.
struct DistributedBoxes {
  std::vector<Box> boxes;
  std::vector<int> first;
};

/// A level's boxes halved along some axes, on the same ranks; none if a cell's children would not fill a box, except at
/// the domain's upper end, or would be in two boxes on the next coarser level. `domain`: the coarser one.
DistributedBoxes halved(Level const& finer, Index3 const& ratio, Box const& domain);

/// Sort boxes along the curve, and distribute them by cells: where each rank's run starts.
std::vector<int> distribute_along_curve(std::vector<Box>& boxes, int ranks);

/// The levels as another rank has them, that of the hierarchy: the same one as a virtual rank sees it. Local.
MultigridLevels seen_by(MultigridLevels multigrid, Hierarchy const& hierarchy);

/// Factor of the last cell in the ghost behind a wall that prolongation from level l reads.
Real prolonged_end(MultigridLevels const& multigrid, OpenWalls const& open_walls, std::size_t l, Index3 const& cell,
                   int axis, int side);

/// What the children of a level's cells weigh at the upper ends of a level `finer`; see `last_children`.
std::array<LastChildren, 3> last_children_of(MultigridLevels const& multigrid, std::size_t finer);

}  // namespace amrpic
