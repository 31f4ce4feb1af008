#include "mesh/level.hpp"

#include <algorithm>

#include "base/search.hpp"

namespace amrpic {

Level::Level(Box domain, std::array<bool, 3> periodic, Real3 spacing, std::vector<Box> boxes,
             std::vector<int> first_box, int rank)
    : Level(domain, periodic, spacing, std::make_shared<BoxTable const>(std::move(boxes)), std::move(first_box), rank) {
}

Level::Level(Box domain, std::array<bool, 3> periodic, Real3 spacing, std::shared_ptr<BoxTable const> table,
             std::vector<int> first_box, int rank)
    : domain_(domain), periodic_(periodic), spacing_(spacing), table_(std::move(table)), rank_(rank) {
  auto const in_use = [&first_box] {
    int out = 0;
    for (std::size_t r = 1; r < first_box.size(); ++r) out += first_box[r] > first_box[r - 1];
    return out;
  }();
  owners_ = std::make_shared<Owners const>(Owners{std::move(first_box), in_use});
}

int Level::owner(int b) const {
  auto const& first = owners_->first_box;
  auto const guess = first.begin() + std::ptrdiff_t(std::int64_t(b) * ranks() / box_count());  // runs of equal length
  return int(lower_bound_from(first.begin() + 1, first.end(), guess + 1, b + 1) - first.begin()) - 1;
}

std::vector<Index3> Level::images(Box const& region) const {
  if (!periodic_[0] && !periodic_[1] && !periodic_[2]) return {{0, 0, 0}};
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

GlobalIndex Level::cells_in(Box const& region) const {
  GlobalIndex out = 0;
  for (auto const& shift : images(region)) out += table_->cells_in(region.shift_back(shift).intersect(domain_));
  return out;
}

bool Level::same_as(Level const& other) const {
  return this == &other || (domain_ == other.domain_ && periodic_ == other.periodic_ && spacing_ == other.spacing_ &&
                            (owners_ == other.owners_ || owners_->first_box == other.owners_->first_box) &&
                            (table_ == other.table_ || boxes() == other.boxes()));
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

bool has_long_cells(Level const& level) {
  auto const [least, most] = std::minmax_element(level.spacing().begin(), level.spacing().end());
  return is_long(*most, *least);
}

}  // namespace amrpic
