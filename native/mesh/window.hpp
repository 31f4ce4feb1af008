#pragma once

#include <vector>

#include "mesh/level.hpp"

namespace amrpic {

/// Values on a block of cells with any corner: a small dense picture of a part of a level.
template <class T>
class Window {
 public:
  Window(Box const& box, T value) : box_(box), values_(std::size_t(box.cells()), value) {}
  Box const& box() const { return box_; }
  T& operator()(Index3 const& cell) { return values_[std::size_t(box_.offset(cell))]; }
  T const& operator()(Index3 const& cell) const { return values_[std::size_t(box_.offset(cell))]; }
  std::vector<T> const& values() const { return values_; }
  std::vector<T>& values() { return values_; }

 private:
  Box box_;
  std::vector<T> values_;
};

constexpr GlobalIndex no_cell = -1;

/// The numbers of a level's cells in a region, `no_cell` where the level has none; periodic images included.
inline Window<GlobalIndex> cell_numbers(Level const& level, Box const& region) {
  Window<GlobalIndex> out(region, no_cell);
  level.for_each_overlap(region, [&](int b, Box const& part, Index3 const& shift) {
    Box const image = level.box(b).shift(shift);
    for (int k = part.lower[2]; k <= part.upper[2]; ++k)
      for (int j = part.lower[1]; j <= part.upper[1]; ++j) {
        GlobalIndex number = level.box_offset(b) + image.offset({part.lower[0], j, k});
        GlobalIndex* row = &out({part.lower[0], j, k});
        for (int i = 0; i < part.extent(0); ++i) row[i] = number + i;
      }
  });
  return out;
}

/// 1 where the next finer level covers a cell of `region` (indices of the coarser level), 0 elsewhere.
inline Window<char> covered_cells(Level const& finer, Index3 const& ratio, Box const& region) {
  Window<char> out(region, 0);
  finer.for_each_overlap(region.refine(ratio), [&](int, Box const& part, Index3 const&) {
    for_each_cell(part.coarsen(ratio).intersect(region), [&](Index3 const& c) { out(c) = 1; });
  });
  return out;
}

}  // namespace amrpic
