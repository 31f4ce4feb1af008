// The charges of leaves near walls, one by one.
#pragma once

#include <array>
#include <vector>

#include "freespace/octree.hpp"

namespace amrpic::freespace {

/// The charges of a leaf, as they travel.
struct LeafRecord {
  BlockKey key;
  BlockCharges charges;
};

/// Those of some leaves of a tree.
class LeafCharges {
 public:
  /// Of the leaves below `nodes`. `across`: the axes, that of consecutive charges first. `received`: of other ranks.
  LeafCharges(Octree const& tree, ChargeBlocks const& own, std::vector<LeafRecord> const& received,
              std::vector<int> nodes, std::array<int, 3> const& across);

  /// From the first cell of the leaf's bounding box on.
  BlockCharges const& of(int leaf) const { return blocks_[std::size_t(place_[std::size_t(leaf)])]; }

 private:
  void add(TreeNode const& node, BlockCharges const& charges, std::array<int, 3> const& across);

  std::vector<int> place_;  ///< by number of the leaf, or -1
  std::vector<BlockCharges> blocks_;
};

}  // namespace amrpic::freespace
