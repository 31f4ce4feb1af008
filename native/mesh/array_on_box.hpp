#pragma once

#include <algorithm>
#include <numeric>
#include <vector>

#include "mesh/level.hpp"

namespace amrpic {

/// A dense array of values on a box, x fastest.
template <class T>
class ArrayOnBox {
 public:
  ArrayOnBox(Box const& box, T value) : box_(box), values_(std::size_t(box.cells()), value) {}
  Box const& box() const { return box_; }
  T& operator()(Index3 const& cell) { return values_[std::size_t(box_.offset(cell))]; }
  T const& operator()(Index3 const& cell) const { return values_[std::size_t(box_.offset(cell))]; }
  std::vector<T> const& values() const { return values_; }
  std::vector<T>& values() { return values_; }

  /// Set the cells that the box has in common with another one.
  void fill(Box const& other, T value) {
    Box const part = box_.intersect(other);
    if (part.empty()) return;
    for_each_row(part, [&](Index3 const& first) { std::fill_n(&(*this)(first), part.extent(0), value); });
  }

 private:
  Box box_;
  std::vector<T> values_;
};

constexpr GlobalIndex no_cell = -1;

/// Call `f(number of the first cell, count, first cell in the region's indices)` for each row along x of a part of box
/// b that `Level::for_each_overlap` gave.
template <class F>
void for_each_row(Level const& level, int b, Box const& part, Index3 const& shift, F&& f) {
  Box const image = level.box(b).shift(shift);
  for_each_row(part, [&](Index3 const& first) {
    f(level.box_offset(b) + image.offset(first), LocalIndex(part.extent(0)), first);
  });
}

/// The numbers of a level's cells in a region, `no_cell` where the level has none; periodic images included.
inline ArrayOnBox<GlobalIndex> cell_numbers(Level const& level, Box const& region) {
  ArrayOnBox<GlobalIndex> out(region, no_cell);
  level.for_each_overlap(region, [&](int b, Box const& part, Index3 const& shift) {
    for_each_row(level, b, part, shift, [&](GlobalIndex first, LocalIndex count, Index3 const& cell) {
      std::iota(&out(cell), &out(cell) + count, first);
    });
  });
  return out;
}

/// 1 where the next finer level covers a cell of `region` (indices of the coarser level), 0 elsewhere.
inline ArrayOnBox<char> covered_cells(Level const& finer, Index3 const& ratio, Box const& region) {
  ArrayOnBox<char> out(region, 0);
  finer.for_each_overlap(region.refine(ratio),
                         [&](int, Box const& part, Index3 const&) { out.fill(part.coarsen(ratio), 1); });
  return out;
}

}  // namespace amrpic
