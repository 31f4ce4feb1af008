#pragma once

#include <functional>
#include <vector>

#include "mesh/halo.hpp"
#include "mesh/hierarchy.hpp"
#include "particle/ghost_cells.hpp"

namespace amrpic {

/// The ghost cells of one box of this rank.
struct BoxGhosts {
  int level, box;
  GhostCells ghosts;
  Box parents;  ///< the box coarsened and grown by the reach; empty if the level has all ghost cells
  std::vector<LocalIndex>
      coarse;  ///< for each cell of `parents`, its place in [own | halo] of the coarser level; -1: not needed, or none
};

/// Where the values of the ghost cells of this rank's boxes are kept, level by level.
struct GhostPlan {
  std::vector<BoxGhosts> boxes;
  std::vector<Halo> halos;  ///< per level: all cells of other ranks that `boxes` name
};

/// That of as many layers of ghost cells as `reach` says. What a level lacks is interpolated from the coarser one: of
/// the cells for that the one layer exists that nesting promises. `more(level, reads)` adds to what is read. Local.
GhostPlan ghost_plan(Hierarchy const& hierarchy, int reach, std::function<void(int, CellReads&)> const& more = nullptr);

}  // namespace amrpic
