#include "mesh/box_table.hpp"

#include <algorithm>

#include "base/search.hpp"
#include "mesh/array_on_box.hpp"

namespace amrpic {

namespace {

/// Coordinates of a bin in one number, x in the lowest digits; 21 bits each, so that bins outside the domain have keys
/// of their own.
std::int64_t key(int i, int j, int k) {
  constexpr std::int64_t half = 1 << 20;
  return (i + half) | ((j + half) << 21) | ((k + half) << 42);
}

}  // namespace

BoxTable::BoxTable(std::vector<Box> boxes) : boxes_(std::move(boxes)), offset_(boxes_.size() + 1, 0) {
  for (std::size_t b = 0; b < boxes_.size(); ++b) {
    offset_[b + 1] = offset_[b] + boxes_[b].cells();
    for (int d = 0; d < 3; ++d) bin_[d] = std::max(bin_[d], boxes_[b].extent(d));
  }
  std::size_t entries = 0;
  for (Box const& box : boxes_) entries += std::size_t(box.coarsen(bin_).cells());
  entries_.reserve(entries);
  for (int b = 0; b < count(); ++b)
    for_each_cell(box(b).coarsen(bin_), [&](Index3 const& c) { entries_.push_back({key(c[0], c[1], c[2]), b}); });
  std::sort(entries_.begin(), entries_.end());
}

int BoxTable::box_of_cell(GlobalIndex cell) const {
  return int(std::upper_bound(offset_.begin() + 1, offset_.end(), cell) - offset_.begin()) - 1;
}

template <class F>
void BoxTable::visit(Box const& region, F&& f) const {
  if (region.empty()) return;
  Box const bins = region.coarsen(bin_);
  Entry const first{key(bins.lower[0], bins.lower[1], bins.lower[2]), 0};
  auto at = std::lower_bound(entries_.begin(), entries_.end(), first);
  for (int k = bins.lower[2]; k <= bins.upper[2]; ++k)
    for (int j = bins.lower[1]; j <= bins.upper[1]; ++j) {
      std::int64_t const last = key(bins.upper[0], j, k);
      at = lower_bound_from(entries_.begin(), entries_.end(), at, Entry{key(bins.lower[0], j, k), 0});
      for (; at != entries_.end() && at->bin <= last; ++at) {
        Box const part = box(at->box).intersect(region);
        if (part.empty()) continue;
        // a box that meets several bins counts in the one of the lowest cell that both have
        Index3 const lowest = Box{part.lower, part.lower}.coarsen(bin_).lower;
        if (at->bin == key(lowest[0], lowest[1], lowest[2]) && f(at->box)) return;
      }
    }
}

int BoxTable::find(Index3 const& cell) const {
  int found = -1;
  visit({cell, cell}, [&](int b) { return found = b, true; });
  return found;
}

std::vector<int> BoxTable::meeting(Box const& region) const {
  std::vector<int> out;
  visit(region, [&](int b) { return out.push_back(b), false; });
  std::sort(out.begin(), out.end());
  return out;
}

bool BoxTable::meets(Box const& region) const {
  bool found = false;
  visit(region, [&](int) { return found = true; });
  return found;
}

GlobalIndex BoxTable::cells_in(Box const& region) const {
  GlobalIndex out = 0;
  visit(region, [&](int b) { return out += region.intersect(box(b)).cells(), false; });
  return out;
}

std::size_t BoxTable::bytes() const {
  return boxes_.capacity() * sizeof(Box) + offset_.capacity() * sizeof(GlobalIndex) +
         entries_.capacity() * sizeof(Entry);
}

std::int64_t outer_faces(BoxTable const& boxes) {
  std::int64_t out = 0;
  for (Box const& box : boxes.boxes())
    for (int axis = 0; axis < 3; ++axis) {
      Box const above = box.layer(axis, 1, 1);
      out += 2 * (above.cells() - boxes.cells_in(above));  // a face inside is above one box and below another
    }
  return out;
}

}  // namespace amrpic
