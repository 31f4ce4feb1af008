#pragma once

#include <cstdint>
#include <vector>

#include "mesh/box.hpp"

namespace amrpic {

/// The disjoint boxes of a level in their final order, and a look-up by cells; immutable, and shared by all levels that
/// have the same boxes, whatever their spacing and owners.
///
/// All ranks hold it in full, so it is lean: 24 bytes of a box, 8 of where its cells start, and 16 for each bin of the
/// look-up that the box meets. Bins are as wide as the longest box, so these are at most eight, and one where boxes are
/// equal and start on multiples of their size.
class BoxTable {
 public:
  explicit BoxTable(std::vector<Box> boxes);

  int count() const { return int(boxes_.size()); }
  std::vector<Box> const& boxes() const { return boxes_; }
  Box const& box(int b) const { return boxes_[std::size_t(b)]; }

  GlobalIndex cells() const { return offset_.back(); }
  GlobalIndex offset(int b) const { return offset_[std::size_t(b)]; }  ///< number of the first cell of a box
  int box_of_cell(GlobalIndex cell) const;

  /// Box that holds a cell, or -1.
  int find(Index3 const& cell) const;
  /// Ascending numbers of the boxes that have cells of a region.
  std::vector<int> meeting(Box const& region) const;
  bool meets(Box const& region) const;            ///< whether a box has a cell of it
  GlobalIndex cells_in(Box const& region) const;  ///< of all boxes

  std::size_t bytes() const;  ///< that it takes

 private:
  /// A box that meets a bin. Sorted by bin, so that those of bins that follow each other along x do so as well.
  struct Entry {
    std::int64_t bin;
    int box;
    bool operator<(Entry const& other) const { return bin != other.bin ? bin < other.bin : box < other.box; }
  };
  /// Call `f(box)` for each box that has cells of a region, until it returns true; by bins.
  template <class F>
  void visit(Box const& region, F&& f) const;

  std::vector<Box> boxes_;
  std::vector<GlobalIndex> offset_;  ///< boxes + 1 values
  Index3 bin_{1, 1, 1};              ///< extent of a bin, cells
  std::vector<Entry> entries_;
};

/// The number of cell faces on the surface of the union of the boxes.
std::int64_t outer_faces(BoxTable const& boxes);

}  // namespace amrpic
