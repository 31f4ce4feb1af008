#pragma once

#include "mesh/array_on_box.hpp"
#include "mesh/halo.hpp"
#include "mesh/hierarchy.hpp"
#include "particle/geometry.hpp"

namespace amrpic {

/// The cells of a coarser level that the clouds of one box's buffer particles touch.
struct CoarseCells {
  int level;
  Box box;  ///< the box coarsened to that level; clouds reach `tile_reach` cells further
  /// For each cell of `box` grown by the reach: its place in [own | halo] of the level, -1: not touched.
  std::vector<LocalIndex> place;
};

/// One box, or brick, in the matched treatment of coarse-fine faces.
struct BoxBuffer {
  /// For each parent of the box's cells: how many levels coarser than the box the clouds of its particles are.
  ArrayOnBox<char> depth{Box{}, 0};
  std::vector<CoarseCells> coarse;  ///< coarse[r - 1] for the clouds that are r levels coarser; empty: none are

  int depth_of(Index3 const& cell) const { return depth(parent_of(cell)); }
};

/// The buffer in a region of a level, a box or a brick of it, without the places of the cells that are touched. Local.
BoxBuffer buffer_of(Hierarchy const& hierarchy, int level, Box const& region);

/// Where particles of a refined level lie so close to its edge that they deposit and gather with the cloud of the next
/// coarser level; made once per hierarchy.
///
/// The buffer is one coarse cell deep: a particle lies in it if the parent of its cell has an unrefined cell among its
/// 26 neighbours, which is to say that its distance to the unrefined region, the largest along the three axes, is below
/// two fine cells. So all particles of a cell are treated equally. Walls are no edge, periodic faces are passed
/// through. If the parent lies itself in the buffer of its level, the cloud is coarser still.
class BufferZone {
 public:
  /// Collective.
  explicit BufferZone(Hierarchy const& hierarchy);

  /// The buffer in one of this rank's boxes, numbered level by level; null if it has none.
  BoxBuffer const* box(std::size_t slot) const { return boxes_[slot].coarse.empty() ? nullptr : &boxes_[slot]; }
  Halo const& halo(int level) const { return halos_[level]; }  ///< remote cells that `box` names

 private:
  std::vector<BoxBuffer> boxes_;
  std::vector<Halo> halos_;
};

}  // namespace amrpic
