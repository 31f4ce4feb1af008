// The lattice Green's function around the origin, laid out for sums over rows of charges.
#pragma once

#include <array>
#include <cstddef>
#include <map>
#include <memory>
#include <mutex>
#include <vector>

#include "freespace/lattice.hpp"

namespace amrpic::freespace {

/// Offsets of either sign, perhaps between the lattice points.
///
/// Entry (i, j, k) is the potential of a unit charge at the lattice point (i, j, k), seen from the point `shift`, 0 <=
/// shift < 1. Half way between points it is their mean: exact to fourth order away from the charge if cells are cubes,
/// and what an average over the eight finer cells of a coarse one gives. Elsewhere it is the cubic Lagrange
/// interpolant.
class KernelTable {
 public:
  /// From an octant as `lattice_green_octant` gives it. The table reaches two points less far than the octant.
  KernelTable(std::vector<double> const& octant, Cell const& octant_reach, Point const& shift);

  Cell const& reach() const { return reach_; }
  /// Entries (i, j, k), (i + 1, j, k), ...; |i| <= reach.
  double const* row(int i, int j, int k) const {
    return values_.data() + (i + reach_[0] + stride_y_ * (j + reach_[1]) + stride_z_ * (k + reach_[2]));
  }
  /// From row (i, j, k) to (i, j + 1, k), or to (i, j, k + 1).
  std::ptrdiff_t stride(int axis) const { return axis == 1 ? stride_y_ : stride_z_; }

 private:
  void interpolate(int axis, double shift, std::array<std::ptrdiff_t, 3>& size);

  Cell reach_;
  std::ptrdiff_t stride_y_, stride_z_;
  std::vector<double> values_;
};

/// Tables of one lattice shape, made when first asked for. The Green's function itself is kept for the life of the
/// process.
class KernelTables {
 public:
  KernelTables(Point const& shape, Cell const& reach) : shape_(shape), reach_(reach) {}
  KernelTable const& at(Point const& shift);

 private:
  Point shape_;
  Cell reach_;
  std::mutex guard_;
  std::map<Point, std::unique_ptr<KernelTable const>> tables_;
};

}  // namespace amrpic::freespace
