#pragma once

#include <cassert>
#include <cstdint>
#include <vector>

#include "base/kokkos.hpp"
#include "cycle/copies_across_ranks.hpp"
#include "cycle/vector.hpp"
#include "mesh/level.hpp"

namespace amrpic::cycle {

/// Where a rectangle of cells lies in a Vector: cell (i, j, k) past its lower corner at origin + i + j pitch_y + k
/// pitch_z.
struct Placement {
  std::ptrdiff_t origin = 0, pitch_y = 0, pitch_z = 0;

  KOKKOS_INLINE_FUNCTION std::ptrdiff_t place(int i, int j, int k) const {
    return origin + i + j * pitch_y + k * pitch_z;
  }
  std::ptrdiff_t stride(int axis) const { return axis == 0 ? 1 : axis == 1 ? pitch_y : pitch_z; }
};

/// A box of cells in this rank's memory: boxes of the level that make up a larger box, or cells of other ranks that the
/// sweeps need.
struct CellBlock {
  Box box;          ///< outside the domain where it is the image across a periodic boundary
  Placement cells;  ///< rows padded to whole vectors
  int lanes = 16;   ///< cells per vector

  std::ptrdiff_t place(Index3 const& c) const {
    assert(box.contains(c));
    return cells.place(c[0] - box.lower[0], c[1] - box.lower[1], c[2] - box.lower[2]);
  }
  int vectors() const { return int(cells.pitch_y) / lanes; }
};

/// Rows of a plane of a block, chosen by a number that each has.
struct RowChoice {
  std::int8_t const* number = nullptr;  ///< of each row; null: all rows
  int least = 0, most = 0;

  bool contains(int j) const { return number == nullptr || (number[j] >= least && number[j] <= most); }
};

/// Own cells of which a rank keeps a copy across a periodic boundary.
struct Image {
  int box;       ///< of the level
  Box cells;     ///< in that box's indices
  Index3 shift;  ///< added, gives the indices of the copy
};

/// Call f(part, where it lies) for the parts of a box in blocks, or in whatever else has a box and a placement.
template <class Block, class F>
void for_each_part(Block first, Block last, Box const& box, F&& f) {
  for (; first != last; ++first) {
    Box const part = box.intersect(first->box);
    if (part.empty()) continue;
    Placement at = first->cells;
    at.origin = first->place(part.lower);
    f(part, at);
  }
}

/// How a level lies in a rank's memory for the sweeps: its own boxes, joined to larger ones where they fill them, so
/// that the size of boxes hardly matters, then the halo.
class Layout {
 public:
  /// `halo`: how many cells deep the copies of other ranks' cells are. Along axes with a `seam` the last plane of cells
  /// is a block of its own, since what it exchanges with its neighbours is not what others do.
  Layout(Level const& level, int halo, std::array<bool, 3> const& seam);

  std::vector<CellBlock> const& blocks() const { return blocks_; }  ///< own ones first
  std::size_t own_blocks() const { return own_blocks_; }
  bool has_halo() const { return blocks_.size() > own_blocks_; }
  bool has_seam() const { return has_seam_; }
  int first_halo_plane() const { return first_halo_plane_; }  ///< the lowest plane of z that holds some of it
  /// The rows of a plane with cells from which so many steps across faces of cells lead to own ones: all rows of own
  /// blocks.
  RowChoice rows_in_reach(std::size_t block, int k, int steps) const {
    return block < own_blocks_ ? RowChoice{} : RowChoice{rows(block, k), 0, steps};
  }
  /// The rows of a plane of an own block of which other ranks, or this one outside the domain, have copies of some
  /// cells, or those of which they have none.
  RowChoice rows_by_copies(std::size_t block, int k, bool copied) const {
    return {rows(block, k), copied ? 1 : 0, copied ? 1 : 0};
  }
  /// So many steps each row of a plane of a copied block is away from own cells.
  std::int8_t const* steps_to_own(std::size_t block, int k) const { return rows(block, k); }
  std::vector<Image> const& images() const { return copied_images_; }      ///< that are copied
  CopiesAcrossRanks const& across_ranks() const { return across_ranks_; }  ///< what passes between ranks for the halo

  /// Call f(part, where it lies) for the parts of a box in own blocks, or in the halo.
  template <class F>
  void for_each_own_part(Box const& box, F&& f) const {
    for_each_part(blocks_.begin(), blocks_.begin() + std::ptrdiff_t(own_blocks_), box, f);
  }
  template <class F>
  void for_each_copied_part(Box const& box, F&& f) const {
    for_each_part(blocks_.begin() + std::ptrdiff_t(own_blocks_), blocks_.end(), box, f);
  }

  std::size_t size() const { return size_; }  ///< of a Vector that holds the level
  /// Place of a row that belongs to no cell and stays zero.
  std::ptrdiff_t zero_row() const { return zero_row_; }
  Placement box(int b) const {
    return boxes_[std::size_t(b - first_box_)];
  }  ///< of this rank, by its number on the level

  /// Place of a cell, also where its image is read in place; -1 if it is not in memory.
  std::ptrdiff_t find(Index3 const& cell) const;

  /// Call f(block, part, shift) where a region meets blocks, images that are read in place first: `part` in the
  /// region's indices, `part` minus `shift` inside the block.
  template <class F>
  void for_each_overlap(Box const& region, F&& f) const {
    for (auto const& shift : images_) {
      Box reach = domain_.shift(shift);
      reach.lower[2] = region.lower[2], reach.upper[2] = region.upper[2];
      if (shift != Index3{0, 0, 0} && region.intersect(reach).empty()) continue;
      for (int b : near(region.lower[2], region.upper[2])) {
        Box const part = region.intersect(blocks_[std::size_t(b)].box.shift(shift));
        if (!part.empty()) f(blocks_[std::size_t(b)], part, shift);
      }
    }
  }

  /// Blocks that hold cells of a plane of z, lowest plane first.
  int first_plane() const { return first_plane_; }
  int planes() const { return int(plane_.size()); }
  std::vector<int> const& on_plane(int k) const { return plane_[std::size_t(k - first_plane_)]; }

 private:
  bool in_place(Index3 const& shift) const;
  std::vector<int> near(int lower_plane, int upper_plane) const;
  void add(Box const& box);
  void mark_copied(Box const& cells);
  void measure_halo(int halo);
  std::int8_t const* rows(std::size_t block, int k) const {
    CellBlock const& b = blocks_[block];
    return &rows_of_[block][std::size_t(k - b.box.lower[2]) * std::size_t(b.box.extent(1))];
  }

  Box domain_;
  std::array<bool, 3> wraps_;   ///< whether images across the axis are read in place
  std::vector<Index3> images_;  ///< shifts of those within the sweeps' reach, none at all last
  int first_box_;
  bool has_seam_;
  std::vector<CellBlock> blocks_;
  std::size_t own_blocks_ = 0, size_ = 0;
  std::ptrdiff_t zero_row_ = 0;
  std::vector<Image> copied_images_;
  CopiesAcrossRanks across_ranks_;
  int first_halo_plane_ = 0;
  std::vector<std::vector<std::int8_t>> rows_of_;  ///< of each block: whether a row is copied, or the steps from it
  std::vector<Placement> boxes_;
  int first_plane_ = 0;
  std::vector<std::vector<int>> plane_;
};

}  // namespace amrpic::cycle
