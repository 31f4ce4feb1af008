// Which rank does what for the potential behind open walls, and who sends what to whom: it follows from the boxes of
// the mesh alone, for any rank, without messages.
//
// A block of the octree belongs to the rank that has its middle cell, and a patch of ghosts to whom WallPatches gives
// it. Blocks that no charge is in are planned for like all others; what is sent holds those that have some.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include "freespace/sight.hpp"
#include "mesh/exchange.hpp"

namespace amrpic::freespace {

/// A block or a leaf whose content another rank gets.
struct Gift {
  Block block;
  int rank;
  bool operator<(Gift const& o) const { return block == o.block ? rank < o.rank : block < o.block; }
  bool operator==(Gift const& o) const { return block == o.block && rank == o.rank; }
};

/// Lists of unknown length from some ranks to others.
struct Senders {
  std::vector<int> to, from;  ///< ascending
};

/// Values of known number: place n of what is asked of this rank goes into parcel n, and what is wanted likewise.
struct Transfer {
  std::vector<Parcel> asked, wanted;
  std::vector<int> give, take;  ///< number of a patch of this rank, for each parcel
};

/// Charges of cells that belong to a leaf of another rank.
struct LeafPart {
  int rank;  ///< the other one
  BlockKey key;
  Box cells;  ///< of the level
  int box;    ///< this rank's, counted from its first one over all levels; -1: of the other rank
};

/// What all ranks know of the walls of a mesh.
struct WallGeometry {
  WallGeometry(WallMesh const& given, Options const& options);

  WallMesh mesh;
  BlockGrids grids;
  WallPatches patches;
  Sight sight;
  int top;                   ///< the grid that is known on all ranks
  int fewest_sharing_ranks;  ///< of the options
  /// Whether the potential is summed axis by axis on every rank, from all charge, and not by the tree: where so many
  /// images are near that the tree would take them one by one. See `heat_sums.hpp`.
  bool by_axes;

  /// The rank of a block, or -1 if the mesh has no cells in it.
  int home(Block const& block) const;

  std::vector<Block> top_blocks() const;  ///< all of the top, with charge or not
  bool is_shared() const;                 ///< whether the ranks do
  /// How many grids below the top one this is.
  int below_top(int grid) const;
  /// The children that blocks known on all ranks may have, if the ranks share these too; else none.
  std::vector<Block> shared_children(std::vector<Block> const& blocks) const;
};

constexpr int lowest_octave = -1100, octaves = 2200;  ///< of doubles
constexpr int most_levels = 64;

class WallPlan {
 public:
  /// Of one rank, any.
  WallPlan(std::shared_ptr<WallGeometry const> geometry, int rank);

  WallGeometry const& geometry() const { return *geometry_; }
  int rank() const { return rank_; }

  // In the order of a solve.
  std::vector<LeafPart> parts_out, parts_in;  ///< by rank, then leaf
  std::vector<BlockKey> foreign;              ///< leaves of other ranks with cells of this one, ascending
  std::vector<std::vector<Gift>> upwards;     ///< by grid: this rank's blocks whose parent is another rank's
  std::vector<Senders> joins;                 ///< by grid, of the children's nodes
  std::vector<Gift> families, leaves;         ///< whose children, and whose charges, other ranks may need; ascending
  std::vector<Gift> seen;  ///< parents of families that this rank may need, with their ranks, if they share; ascending
  Senders family_ranks, leaf_ranks;
  std::vector<GhostPatch> patches;              ///< of this rank, and all around them; children before parents
  std::vector<char> is_own;                     ///< each of them
  std::vector<Transfer> down;                   ///< from parents, a step per generation
  std::vector<std::vector<int>> generations;    ///< of patches, from the widest on
  Transfer blocks;                              ///< values of blocks of ghosts to the owners of the cells before them
  std::vector<int> wall_blocks;                 ///< this rank's, by number in the geometry, ascending
  std::vector<std::array<int, 2>> kept_blocks;  ///< patch and wall block of those that it evaluates itself

  /// Of families whose parents are at least so many grids below the top, where the blocks that are known on all ranks
  /// are the ones with charge; without any, if ranks do not share, of all.
  Senders family_ranks_below(std::vector<Block> known, int below) const;

  /// Call f(block) for the blocks that patches of this rank may open, and for the leaves that they may sum, several
  /// times for some; until f returns true.
  void for_each_seen(std::function<bool(Block const&)> const& f) const;

  /// Place of a ghost's value among those of the blocks at this rank's walls.
  std::size_t place(int face, int layer, int level, Index3 const& cell) const;

 private:
  std::vector<Block> own_blocks(int grid) const;
  template <class F>
  void for_each_own_box(F&& f) const;
  void plan_parts();
  void plan_joins();
  void plan_patches();
  void plan_gifts();
  void plan_sources();
  void find_wall_blocks();
  void plan_walls();

  std::shared_ptr<WallGeometry const> geometry_;
  int rank_;
  std::vector<std::vector<Block>> own_blocks_;  ///< by grid
  std::vector<int> numbers_;                    ///< of `patches`, in the geometry
};

}  // namespace amrpic::freespace
