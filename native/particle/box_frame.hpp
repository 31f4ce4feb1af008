#pragma once

#include "particle/locate.hpp"

namespace amrpic {

/// One box's place in space.
struct BoxFrame {
  LevelCoordinates coordinates;
  Box box;

  /// Whether a place lies in the box; it becomes the coordinate in cell widths from the box's lower corner, in [0,
  /// extent): the difference is exact, where adding the reach could round it up to the next cell.
  KOKKOS_INLINE_FUNCTION bool enter(Real3& x) const {
    bool in = true;
    for (int d = 0; d < 3; ++d) {
      x[d] = coordinates.along(d, x[d]);
      in &= (x[d] >= box.lower[d]) & (x[d] < box.upper[d] + 1);
      x[d] -= box.lower[d];
    }
    return in;
  }
};

}  // namespace amrpic
