// The blocks of the octree, grid by grid: all that does not depend on where charge is.
//
// The leaves are blocks of 8 x 8 x 8 cells of any level. Where cells are long, those of a level are merged across them
// first, until blocks are about as wide as long. Such a block of level l lies in one of level l - 1, so refined charge
// only adds depth; above the base, blocks double until one holds the domain.
#pragma once

#include <tuple>
#include <vector>

#include "freespace/charge_blocks.hpp"
#include "mesh/box.hpp"

namespace amrpic::freespace {

/// Cells of a level along each axis of its widest blocks: 8 x 8 x 8 where cells are about cubes. Where they are not, as
/// many times more across the long ones as make the blocks about as wide as long.
Cell widest_blocks(Point const& shape);

inline bool by_place(Cell const& a, Cell const& b) { return std::tie(a[2], a[1], a[0]) < std::tie(b[2], b[1], b[0]); }

/// Block `place` of a grid.
struct Block {
  int grid;
  Cell place;
  bool operator==(Block const& o) const { return grid == o.grid && place == o.place; }
  bool operator<(Block const& o) const { return grid != o.grid ? grid < o.grid : by_place(place, o.place); }
};

/// Blocks of one size. Their children are blocks of up to two other grids.
struct BlockGrid {
  int level;
  Cell width;      ///< of a block, in cells of the level
  int finer = -1;  ///< grid of the children with charge of finer levels, two along each axis; or none
  int own = -1;    ///< grid of those of the level's own charge, or none
  Cell shift{};    ///< these are 2^shift along each axis
  int parent = -1;

  bool is_leaf() const { return finer < 0 && own < 0; }
};

class BlockGrids {
 public:
  BlockGrids(Lattice const& lattice, int finest);

  int count() const { return int(grids_.size()); }  ///< children before parents; the last one is a single block
  BlockGrid const& operator[](int grid) const { return grids_[std::size_t(grid)]; }
  int leaves(int level) const { return leaves_[std::size_t(level)]; }
  /// The finest grid that holds all charge in so few blocks.
  int with_at_most(int blocks) const;

  Cell extent(int grid) const;      ///< blocks along each axis
  Box cells(Block const& b) const;  ///< of its level, inside the domain
  Block parent(Block const& b) const;

  /// Call f(child) for the places of children, in the order in which they are joined.
  template <class F>
  void for_each_child(Block const& b, F&& f) const {
    BlockGrid const& grid = grids_[std::size_t(b.grid)];
    for (int child : {grid.finer, grid.own}) {
      if (child < 0) continue;
      Cell const shift = child == grid.finer ? Cell{1, 1, 1} : grid.shift, end = extent(child);
      Cell first, last, place;
      for (int d = 0; d < 3; ++d) {
        first[d] = b.place[d] << shift[d];
        last[d] = std::min(end[d], (b.place[d] + 1) << shift[d]);
      }
      for (place[2] = first[2]; place[2] < last[2]; ++place[2])
        for (place[1] = first[1]; place[1] < last[1]; ++place[1])
          for (place[0] = first[0]; place[0] < last[0]; ++place[0]) f(Block{child, place});
    }
  }

 private:
  Cell cells_;  ///< of the base
  std::vector<BlockGrid> grids_;
  std::vector<int> leaves_;  ///< by level
};

}  // namespace amrpic::freespace
