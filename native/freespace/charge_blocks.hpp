// Charges of this rank, sorted into blocks of 8 x 8 x 8 cells of their level, and the moments of each block.
//
// Cells are read once: what a block adds up to is found while it lies in the cache, and only charges that may be near
// to a ghost are kept one by one.
#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <vector>

#include "freespace/lattice.hpp"
#include "freespace/solid_harmonics.hpp"

namespace amrpic::freespace {

constexpr int block_edge = 8;
constexpr int block_cells = block_edge * block_edge * block_edge;
using BlockCharges = std::array<double, block_cells>;  ///< x fastest

/// Block `place` of a level: cells 8 place .. 8 place + 7 of that level.
struct BlockKey {
  int level;
  Cell place;
  bool operator==(BlockKey const& o) const {
    return level == o.level && place[0] == o.place[0] && place[1] == o.place[1] && place[2] == o.place[2];
  }
  bool operator<(BlockKey const& o) const;
};

/// Charges of a box of cells of one level, x fastest: `factor` times `values`, in some cells `weighted` once more, and
/// times what is `added` in some. Cells in `covered` do not count, nor those that are `unseen`.
struct ChargeBox {
  struct CellRange {
    Cell lower, upper;  ///< inclusive
  };
  struct Added {
    CellRange cells;
    std::vector<double> values;  ///< x fastest
  };
  struct Weighted {
    CellRange cells;
    double factor;
  };
  int level;
  Cell lower, upper;  ///< inclusive
  double const* values;
  double factor;
  std::vector<CellRange> covered{};
  std::vector<Added> added{};
  std::vector<Weighted> weighted{};
  std::optional<CellRange> unseen{};
};

/// Write the charges of the cells `first` .. `last` of a box, which lie in one block, x fastest.
void copy_charges(ChargeBox const& box, Cell const& first, Cell const& last, double* to);

/// Those of all its cells.
void copy_charges(ChargeBox const& box, double* to);

/// A block with charge.
struct Leaf {
  BlockKey key;
  Cell first, extent;  ///< occupied cells: the bounding box, inside the block
  double magnitude;    ///< sum of |q|

  Cell corner() const {
    return {key.place[0] * block_edge + first[0], key.place[1] * block_edge + first[1],
            key.place[2] * block_edge + first[2]};
  }
  /// Of the bounding box of cell centres, smallest base spacing = 1.
  Point centre(Point const& shape) const;
};

struct LeafMoments {
  Leaf leaf;
  Harmonics<double> moments;  ///< about its centre
};

/// Whether a block comes as near to a wall as `near` cells of its level.
bool is_near_wall(Lattice const& lattice, Cell const& near, BlockKey const& key);

/// The blocks of this rank that hold charge. Boxes do not overlap.
class ChargeBlocks {
 public:
  /// Charges are kept in blocks that come as near to a wall as `kept` cells of their level.
  ChargeBlocks(Lattice const& lattice, Cell const& kept) : lattice_(lattice), shape_(lattice.shape()), kept_(kept) {}

  /// What lies in the blocks `foreign`, ascending, belongs to other ranks and does not count.
  void assign(std::vector<ChargeBox> const& boxes, std::vector<BlockKey> const& foreign);

  std::vector<LeafMoments> const& leaves() const { return leaves_; }
  bool has_charges(std::size_t leaf) const { return place_[leaf] >= 0; }
  BlockCharges const& charges(std::size_t leaf) const { return charges_[std::size_t(place_[leaf])]; }

 private:
  void clear();
  void add(BlockKey const& key, BlockCharges const& charges);

  Lattice lattice_;
  Point shape_;
  Cell kept_;
  std::vector<LeafMoments> leaves_;
  std::vector<int> place_;  ///< of a leaf's charges, or -1
  std::vector<BlockCharges> charges_;
};

}  // namespace amrpic::freespace
