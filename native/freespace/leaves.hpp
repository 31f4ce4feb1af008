// The leaves of the octree: blocks with charge on any rank.
//
// All ranks agree on one sorted list, so that what follows does not depend on how the cells are distributed.
#pragma once

#include <array>
#include <vector>

#include "base/communicator.hpp"
#include "freespace/charge_blocks.hpp"

namespace amrpic::freespace {

/// All leaves, sorted, the same list on every rank; the weakest are left out while they sum to less than `dropped` of
/// all |q|. `shape`: base spacings. Collective.
std::vector<LeafMoments> agree_on_leaves(Communicator const& comm, ChargeBlocks const& blocks, Point const& shape,
                                         double dropped);

/// The charges of some leaves.
class LeafCharges {
 public:
  /// Fetch the leaves marked in `wanted`, which is the same on all ranks. `across`: the axes, that of consecutive
  /// charges first. Collective.
  LeafCharges(Communicator const& comm, ChargeBlocks const& blocks, std::vector<LeafMoments> const& leaves,
              std::vector<char> const& wanted, std::array<int, 3> const& across);

  /// From the first cell of the leaf's bounding box on.
  BlockCharges const& of(int leaf) const { return blocks_[std::size_t(place_[leaf])]; }

 private:
  std::vector<int> place_;
  std::vector<BlockCharges> blocks_;
};

}  // namespace amrpic::freespace
