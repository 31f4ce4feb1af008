#include "freespace/kernel_table.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <map>
#include <tuple>

#include "freespace/lattice_green.hpp"

namespace amrpic::freespace {

namespace {

/// Distance that the first table serves, in short cells, and the further cells along each axis. From a charge that
/// table m does not serve, a block of eight cells is more than 20 points of table m + 1 away, five times what the
/// interpolation between eight of these asks for.
constexpr double first_distance = 40;
constexpr int margin = 24;
constexpr int overhang = 8;  ///< of interpolation at targets and at charges

std::atomic<std::size_t> bytes_alive{0};

/// Means of neighbours along an axis of an octant, which loses its last point.
void average(std::vector<double>& values, std::array<std::ptrdiff_t, 3>& size, int axis) {
  std::array<std::ptrdiff_t, 3> now = size;
  --now[axis];
  std::vector<double> out(std::size_t(now[0] * now[1] * now[2]));
  std::ptrdiff_t const step = axis == 0 ? 1 : axis == 1 ? size[0] : size[0] * size[1];
  for (std::ptrdiff_t k = 0; k < now[2]; ++k)
    for (std::ptrdiff_t j = 0; j < now[1]; ++j)
      for (std::ptrdiff_t i = 0; i < now[0]; ++i) {
        double const* const from = values.data() + i + size[0] * (j + size[1] * k);
        out[std::size_t(i + now[0] * (j + now[1] * k))] = 0.5 * (from[0] + from[step]);
      }
  values = std::move(out);
  size = now;
}

}  // namespace

std::array<int, 3> axes_of_rows(Point const& shape) {
  int const longest = int(std::max_element(shape.begin(), shape.end()) - shape.begin());
  return {longest, longest == 0 ? 1 : 0, longest == 2 ? 1 : 2};
}

KernelTable::KernelTable(Point const& shape, int operator_order, Cell const& reach, Cell const& stride,
                         std::array<bool, 3> const& half)
    : reach_(reach), across_(axes_of_rows(shape)), half_(half) {
  Cell last = reach;
  for (int d = 0; d < 3; ++d) last[d] += half[d] ? 1 : 0;
  auto octant = lattice_green_octant(shape, last, stride, operator_order);
  std::array<std::ptrdiff_t, 3> size{last[0] + 1, last[1] + 1, last[2] + 1};
  for (int d = 0; d < 3; ++d)
    if (half[d]) average(octant, size, d);
  auto const [u, v, w] = across_;
  std::array<std::ptrdiff_t, 3> const step{1, size[0], size[0] * size[1]};
  std::ptrdiff_t const width = 2 * reach[u] + 1;
  pitch_[u] = 1, pitch_[v] = width, pitch_[w] = width * size[v];
  values_.resize(std::size_t(width * size[v] * size[w]));
  double* to = values_.data();
  for (std::ptrdiff_t k = 0; k < size[w]; ++k)
    for (std::ptrdiff_t j = 0; j < size[v]; ++j)
      for (int i = -reach[u]; i <= reach[u]; ++i)
        *to++ = octant[std::size_t(step[u] * folded(u, i) + step[v] * j + step[w] * k)];
}

KernelTables::KernelTables(Point const& shape, int operator_order, Cell const& reach)
    : shape_(shape), operator_order_(operator_order), reach_(reach) {
  for (int d = 0; d < 3; ++d)
    while (cells_served(count_ - 1, d) < reach[d]) ++count_;
  tables_.resize(2 * std::size_t(count_));
}

int KernelTables::cells_served(int number, int axis) const {
  return int(std::min(double(reach_[axis]), std::ceil(std::ldexp(first_distance, number) / shape_[axis]) + margin));
}

int KernelTables::serving(int axis, int offset) const {
  int number = 0;
  while (number + 1 < count_ && cells_served(number, axis) < offset) ++number;
  return number;
}

Cell KernelTables::stride(int number) const {
  double const longest = *std::max_element(shape_.begin(), shape_.end());
  double const apart = std::ldexp(1.0, std::min(number, int(std::ceil(std::log2(2 * longest))) - 1));
  Cell out;
  for (int d = 0; d < 3; ++d) out[d] = 1 << std::max(0, std::ilogb(apart / shape_[d]));
  return out;
}

KernelTable const& KernelTables::at(int number, bool finer) {
  using Key = std::tuple<Point, int, Cell, Cell, std::array<bool, 3>>;
  static std::mutex guard_of_all;
  static std::map<Key, std::weak_ptr<KernelTable const>> all;

  std::lock_guard<std::mutex> lock(guard_);
  auto& table = tables_[2 * std::size_t(number) + (finer ? 1 : 0)];
  if (table) return *table;
  Cell const apart = stride(number);
  std::array<bool, 3> half;
  for (int d = 0; d < 3; ++d) half[d] = finer && apart[d] == 1;
  Cell reach;
  for (int d = 0; d < 3; ++d) reach[d] = (cells_served(number, d) + apart[d] - 1) / apart[d] + overhang;
  std::lock_guard<std::mutex> lock_all(guard_of_all);
  for (auto entry = all.begin(); entry != all.end();) entry = entry->second.expired() ? all.erase(entry) : ++entry;
  auto& shared = all[{shape_, operator_order_, reach, apart, half}];
  table = shared.lock();
  if (!table) {
    auto made = std::make_unique<KernelTable const>(shape_, operator_order_, reach, apart, half);
    std::size_t const size = made->bytes();
    table = std::shared_ptr<KernelTable const>(made.release(), [size](KernelTable const* old) {
      bytes_alive -= size;
      delete old;
    });
    bytes_alive += size;
    shared = table;
  }
  return *table;
}

void KernelTables::trim() {
  std::lock_guard<std::mutex> lock(guard_);
  for (auto table = tables_.rbegin(); table != tables_.rend() && bytes_alive > most_table_bytes; ++table)
    table->reset();
}

std::size_t kernel_table_bytes() { return bytes_alive; }

}  // namespace amrpic::freespace
