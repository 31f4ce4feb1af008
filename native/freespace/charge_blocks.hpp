// Charges sorted into blocks of 8 x 8 x 8 cells of their level: the leaves of the octree.
//
// A rank holds the blocks that its own cells touch. All ranks agree on one list of leaves, sorted, so that what follows
// does not depend on how the cells are dealt out.
#pragma once

#include <mpi.h>

#include <array>
#include <cstdint>
#include <vector>

#include "freespace/lattice.hpp"
#include "freespace/solid_harmonics.hpp"

namespace amrpic::freespace {

constexpr int block_edge = 8;
constexpr int block_cells = block_edge * block_edge * block_edge;

/// Block `place` of a level: cells 8 place .. 8 place + 7 of that level.
struct BlockKey {
  int level;
  Cell place;
  bool operator==(BlockKey const& o) const {
    return level == o.level && place[0] == o.place[0] && place[1] == o.place[1] && place[2] == o.place[2];
  }
  bool operator<(BlockKey const& o) const;
};

/// A charge at a cell centre of its level.
struct PointCharge {
  Point position;
  double charge;
  int level;
};

/// Charges of a box of cells of one level, x fastest: `factor` times `values`. Cells in `covered` do not count.
struct ChargeBox {
  struct Part {
    Cell lower, upper;  ///< inclusive
  };
  int level;
  Cell lower, upper;  ///< inclusive
  double const* values;
  double factor;
  std::vector<Part> covered{};
};

/// The blocks of this rank that hold charge, sorted; the memory is kept from one solve to the next.
class ChargeBlocks {
 public:
  /// Charges at one place add up.
  void assign(Lattice const& lattice, std::vector<PointCharge> const& charges);
  void assign(std::vector<ChargeBox> const& boxes);

  std::size_t size() const { return keys_.size(); }
  BlockKey const& key(std::size_t n) const { return keys_[n]; }
  /// 8 x 8 x 8 charges, x fastest.
  double const* charges(std::size_t n) const { return charges_.data() + n * block_cells; }

 private:
  void reserve_blocks(std::vector<BlockKey> keys);
  /// Charges of a block of this rank, or null.
  double* find(BlockKey const& key);
  void add_box(ChargeBox const& box);

  std::vector<BlockKey> keys_;
  std::vector<double> charges_;
  std::size_t last_ = 0;  ///< the block found last
};

/// A block with charge on any rank.
struct Leaf {
  BlockKey key;
  Cell first, extent;  ///< occupied cells: the bounding box, inside the block
  Cell peak;           ///< the cell with the greatest |q|
  double greatest;     ///< that |q|
  double magnitude;    ///< sum of |q|

  Cell corner() const {
    return {key.place[0] * block_edge + first[0], key.place[1] * block_edge + first[1],
            key.place[2] * block_edge + first[2]};
  }
};

/// All leaves, sorted, the same list on every rank; the weakest are left out while they sum to less than `dropped` of
/// all |q|. Collective.
std::vector<Leaf> agree_on_leaves(MPI_Comm comm, ChargeBlocks const& blocks, double dropped);

/// Moments of every leaf about the centre of its bounding box; `shape`: base spacings. Collective.
std::vector<Harmonics<double>> gather_moments(MPI_Comm comm, ChargeBlocks const& blocks,
                                              std::vector<Leaf> const& leaves, Point const& shape);

/// The charges of some leaves.
class LeafCharges {
 public:
  struct Block {
    std::array<double, block_cells> values;                   ///< from the first cell of the leaf's bounding box on
    std::array<unsigned char, block_edge * block_edge> rows;  ///< those with charge: y + 8 z
    int row_count;
  };

  /// Fetch those `wanted`, alike on all ranks. Collective.
  LeafCharges(MPI_Comm comm, ChargeBlocks const& blocks, std::vector<Leaf> const& leaves,
              std::vector<char> const& wanted);

  Block const& of(int leaf) const { return blocks_[std::size_t(place_[leaf])]; }

 private:
  std::vector<int> place_;
  std::vector<Block> blocks_;
};

}  // namespace amrpic::freespace
