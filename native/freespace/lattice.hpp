// The base lattice and the finer ones inside it, in units in which the smallest base spacing is one.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>

namespace amrpic::freespace {

using Point = std::array<double, 3>;
using Cell = std::array<int, 3>;

/// Base level: cell centres at lower + (i + 1/2) spacing. Level l has cells 2^l times smaller.
struct Lattice {
  Point lower;
  Point spacing;
  Cell cells;

  double unit() const { return std::min({spacing[0], spacing[1], spacing[2]}); }

  /// Base spacings divided by the smallest; rounded, so that lattices of one shape share their tables.
  Point shape() const {
    Point out;
    for (int d = 0; d < 3; ++d) out[d] = std::round(spacing[d] / unit() * 1e12) / 1e12;
    return out;
  }

  /// Cell of a level whose centre a position is.
  Cell cell_at(Point const& position, int level) const {
    Cell out;
    for (int d = 0; d < 3; ++d) out[d] = int(std::floor(std::ldexp((position[d] - lower[d]) / spacing[d], level)));
    return out;
  }
};

}  // namespace amrpic::freespace
