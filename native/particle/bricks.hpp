// How the particles of a box are grouped in memory.
#pragma once

#include <algorithm>

#include "mesh/box.hpp"

namespace amrpic {

/// Cells of a brick. So few that what its particles touch of a tile stays in a first-level cache, whatever their order;
/// so many that few particles leave in a step, which is what makes migration cheap.
constexpr Index3 brick_shape{8, 8, 8};

/// A box cut into bricks, from its lower corner on; those at its end may be smaller. Numbered x fastest.
class Bricks {
 public:
  explicit Bricks(Box const& box) : box_(box) {
    for (int d = 0; d < 3; ++d) count_[d] = (box.extent(d) + brick_shape[d] - 1) / brick_shape[d];
  }
  int count() const { return count_[0] * count_[1] * count_[2]; }
  int count(int axis) const { return count_[std::size_t(axis)]; }
  int number(Index3 const& cell) const {
    Index3 at;
    for (int d = 0; d < 3; ++d) at[d] = (cell[d] - box_.lower[d]) / brick_shape[d];
    return at[0] + count_[0] * (at[1] + count_[1] * at[2]);
  }
  Box operator[](int number) const {
    Index3 const at{number % count_[0], number / count_[0] % count_[1], number / count_[0] / count_[1]};
    Box out;
    for (int d = 0; d < 3; ++d) {
      out.lower[d] = box_.lower[d] + at[d] * brick_shape[d];
      out.upper[d] = std::min(out.lower[d] + brick_shape[d] - 1, box_.upper[d]);
    }
    return out;
  }

 private:
  Box box_;
  Index3 count_;
};

}  // namespace amrpic
