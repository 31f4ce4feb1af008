#include "mesh/level.hpp"

#include <algorithm>

namespace amrpic {

Level::Level(Box domain, std::array<bool, 3> periodic, Real3 spacing, std::vector<Box> boxes,
             std::vector<int> first_box, int rank)
    : domain_(domain),
      periodic_(periodic),
      spacing_(spacing),
      boxes_(std::move(boxes)),
      first_box_(std::move(first_box)),
      offset_(boxes_.size() + 1, 0),
      rank_(rank),
      bin_{1, 1, 1} {
  for (std::size_t b = 0; b < boxes_.size(); ++b) {
    offset_[b + 1] = offset_[b] + boxes_[b].cells();
    for (int d = 0; d < 3; ++d) bin_[d] = std::max(bin_[d], boxes_[b].extent(d));
  }
  for (int b = 0; b < box_count(); ++b)
    for_each_cell(boxes_[b].coarsen(bin_), [&](Index3 const& c) { bins_[bin_key(c[0], c[1], c[2])].push_back(b); });
}

int Level::owner(int b) const {
  return int(std::upper_bound(first_box_.begin() + 1, first_box_.end(), b) - first_box_.begin()) - 1;
}

int Level::owner_of_cell(GlobalIndex cell) const {
  int const b = int(std::upper_bound(offset_.begin() + 1, offset_.end(), cell) - offset_.begin()) - 1;
  return owner(b);
}

int Level::find(Index3 const& cell) const {
  auto const bin = bins_.find(
      bin_key(floor_divide(cell[0], bin_[0]), floor_divide(cell[1], bin_[1]), floor_divide(cell[2], bin_[2])));
  if (bin == bins_.end()) return -1;
  for (int b : bin->second)
    if (boxes_[b].contains(cell)) return b;
  return -1;
}

std::int64_t Level::bin_key(int i, int j, int k) const {
  // 21 bits each, offset so that bins left of the domain have keys of their own
  constexpr std::int64_t half = 1 << 20;
  return (i + half) | ((j + half) << 21) | ((k + half) << 42);
}

std::vector<Index3> Level::images(Box const& region) const {
  std::array<std::vector<int>, 3> shifts;
  for (int d = 0; d < 3; ++d) {
    int const n = domain_.extent(d);
    int const first = periodic_[d] ? floor_divide(region.lower[d], n) : 0;
    int const last = periodic_[d] ? floor_divide(region.upper[d], n) : 0;
    for (int s = first; s <= last; ++s) shifts[d].push_back(s * n);
  }
  std::vector<Index3> out;
  for (int z : shifts[2])
    for (int y : shifts[1])
      for (int x : shifts[0]) out.push_back({x, y, z});
  return out;
}

std::vector<int> Level::boxes_near(Box const& region) const {
  std::vector<int> out;
  Box const inside = region.intersect(domain_);
  if (inside.empty()) return out;
  for_each_cell(inside.coarsen(bin_), [&](Index3 const& c) {
    auto const bin = bins_.find(bin_key(c[0], c[1], c[2]));
    if (bin != bins_.end()) out.insert(out.end(), bin->second.begin(), bin->second.end());
  });
  std::sort(out.begin(), out.end());
  out.erase(std::unique(out.begin(), out.end()), out.end());
  return out;
}

bool Level::same_as(Level const& other) const {
  return this == &other || (domain_ == other.domain_ && periodic_ == other.periodic_ && spacing_ == other.spacing_ &&
                            boxes_ == other.boxes_ && first_box_ == other.first_box_);
}

std::shared_ptr<Level const> Level::stretched(Real3 const& factor) const {
  auto out = std::make_shared<Level>(*this);
  for (int d = 0; d < 3; ++d) out->spacing_[d] *= factor[d];
  return out;
}

std::shared_ptr<Level const> Level::seen_by(int rank) const {
  auto out = std::make_shared<Level>(*this);
  out->rank_ = rank;
  return out;
}

}  // namespace amrpic
