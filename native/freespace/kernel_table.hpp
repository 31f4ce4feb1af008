// The lattice Green's function around the origin, laid out for sums over rows of charges.
#pragma once

#include <array>
#include <cstddef>
#include <memory>
#include <mutex>
#include <vector>

#include "freespace/lattice.hpp"

namespace amrpic::freespace {

/// The axes, the one of the longest cells first: along it charges are never merged, so it is that of the lanes.
std::array<int, 3> axes_of_rows(Point const& shape);

/// The potential of a unit charge at offsets of either sign that are multiples of `stride`; along axes that are `half`
/// half way between these. There it is the mean over the points around, eight of them at most: exact to fourth order
/// away from the charge if cells are cubes, and in a coarse cell from finer ones.
class KernelTable {
 public:
  /// `reach`: entries (i, j, k) have |i| <= reach, in strides.
  KernelTable(Point const& shape, int operator_order, Cell const& reach, Cell const& stride,
              std::array<bool, 3> const& half);

  /// Rows lie along the axis `across[0]`: the entries i, i + 1, ... begin at `row`(i) + `along`(across[1], j) +
  /// `along`(across[2], k). Along `half` axes they stand for the distances i - 1/2.
  double const* row(int i) const { return values_.data() + (i + reach_[across_[0]]); }
  std::size_t bytes() const { return values_.capacity() * sizeof(double); }
  std::ptrdiff_t along(int axis, int n) const { return pitch_[std::size_t(axis)] * folded(axis, n); }

 private:
  std::ptrdiff_t folded(int axis, int n) const { return n < 0 ? -n : n > 0 && half_[std::size_t(axis)] ? n - 1 : n; }

  Cell reach_;
  std::array<int, 3> across_;
  std::array<bool, 3> half_;
  std::array<std::ptrdiff_t, 3> pitch_;
  std::vector<double> values_;  ///< x of either sign, y and z folded: the function is even
};

/// The tables of one lattice shape, made when first used and shared with all others of the process that reach as
/// far; the last one frees them, or `trim`.
///
/// Beside long cells the lattice counts as far as ten of them reach, which is hundreds of short ones. But at a distance
/// the function is smooth. So table number m serves distances of up to about 40 * 2^m short cells, and its points are
/// 2^m of these apart, as far as cells do not become longer than the longest. Each has some hundred points along an
/// axis at most, and their number grows with the logarithm of the distance.
class KernelTables {
 public:
  /// `reach`: of all tables together, in cells.
  KernelTables(Point const& shape, int operator_order, Cell const& reach);

  int count() const { return count_; }
  /// The first table that serves charges up to `offset` cells away along an axis.
  int serving(int axis, int offset) const;
  Cell stride(int number) const;
  /// `finer`: for charges of finer levels than the targets, half way along axes on which the points are not apart.
  KernelTable const& at(int number, bool finer);

  /// Give up tables, those that reach furthest first, until all of the process take at most `most_table_bytes`: they
  /// are made again when used. Call it while none of these is in use.
  void trim();

 private:
  int cells_served(int number, int axis) const;

  Point shape_;
  int operator_order_;
  Cell reach_;
  int count_ = 1;
  std::mutex guard_;
  std::vector<std::shared_ptr<KernelTable const>> tables_;
};

constexpr std::size_t most_table_bytes = std::size_t(64) << 20;  ///< that are kept from one evaluation to the next

/// Bytes of all tables that are alive in this process.
std::size_t kernel_table_bytes();

}  // namespace amrpic::freespace
