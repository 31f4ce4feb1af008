#include "freespace/kernel_table.hpp"

#include <utility>

#include "freespace/lattice_green.hpp"

namespace amrpic::freespace {

namespace {

/// Weights of the points -1, 0, 1, 2 for a place `s` in [0, 1] between 0 and 1.
std::array<double, 4> weights_between(double s) {
  if (s == 0.5) return {0, 0.5, 0.5, 0};
  return {-s * (s - 1) * (s - 2) / 6, (s + 1) * (s - 1) * (s - 2) / 2, -(s + 1) * s * (s - 2) / 2,
          (s + 1) * s * (s - 1) / 6};
}

std::vector<double> const& shared_octant(Point const& shape, Cell const& reach) {
  static std::mutex guard;
  static std::map<std::pair<Point, Cell>, std::vector<double>> octants;
  std::lock_guard<std::mutex> lock(guard);
  auto const [entry, is_new] = octants.try_emplace({shape, reach});
  if (is_new) entry->second = lattice_green_octant(shape, reach);
  return entry->second;
}

}  // namespace

KernelTable::KernelTable(std::vector<double> const& octant, Cell const& octant_reach, Point const& shift)
    : values_(octant) {
  std::array<std::ptrdiff_t, 3> size;
  for (int d = 0; d < 3; ++d) {
    reach_[d] = octant_reach[d] - 2;
    size[d] = octant_reach[d] + 1;
  }
  for (int d = 0; d < 3; ++d) interpolate(d, shift[d], size);
  stride_y_ = size[0];
  stride_z_ = size[0] * size[1];
}

/// Replace the places 0, 1, ... along an axis by the distances i - shift, i = -reach .. reach; the kernel is even.
void KernelTable::interpolate(int axis, double shift, std::array<std::ptrdiff_t, 3>& size) {
  std::ptrdiff_t before = 1, after = 1;
  for (int d = 0; d < axis; ++d) before *= size[d];
  for (int d = axis + 1; d < 3; ++d) after *= size[d];
  std::ptrdiff_t const old = size[axis], reach = reach_[axis], now = 2 * reach + 1;
  auto const weights = weights_between(1 - shift);
  std::vector<double> out(std::size_t(before * now * after));
  for (std::ptrdiff_t a = 0; a < after; ++a)
    for (std::ptrdiff_t i = -reach; i <= reach; ++i) {
      auto const line = [&](std::ptrdiff_t n) { return values_.data() + before * (std::abs(n) + old * a); };
      double* to = out.data() + before * (i + reach + now * a);
      for (std::ptrdiff_t b = 0; b < before; ++b)
        to[b] = shift == 0 ? line(i)[b]
                           : weights[0] * line(i - 2)[b] + weights[1] * line(i - 1)[b] + weights[2] * line(i)[b] +
                                 weights[3] * line(i + 1)[b];
    }
  values_ = std::move(out);
  size[axis] = now;
}

KernelTable const& KernelTables::at(Point const& shift) {
  std::lock_guard<std::mutex> lock(guard_);
  auto& table = tables_[shift];
  if (!table) {
    Cell const wider{reach_[0] + 2, reach_[1] + 2, reach_[2] + 2};
    table = std::make_unique<KernelTable const>(shared_octant(shape_, wider), wider, shift);
  }
  return *table;
}

}  // namespace amrpic::freespace
