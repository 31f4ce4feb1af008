#pragma once

#include <array>
#include <cmath>

#include "mesh/box.hpp"
#include "stencil/wall_ghost.hpp"

namespace amrpic {

/// The image of a finite place in [lower, upper), where space repeats from `upper` on; what rounds onto the upper end
/// is the lower one. Places that are there already stay.
inline Real wrapped(Real x, Real lower, Real upper) {
  if (x >= lower && x < upper) return x;
  Real const length = upper - lower;
  Real rest = x - lower;
  if (rest >= length && rest < 2 * length)
    rest -= length;  // exact, as the remainder is, and far faster
  else if (!(rest < 0 && rest >= -length))
    rest = std::fmod(rest, length);
  Real const out = lower + (rest < 0 ? rest + length : rest);
  return out < upper ? out : lower;
}

/// The computational domain: a cuboid in metres, cut into the cells of the base level.
struct Domain {
  Real3 lower;
  Real3 upper;
  Index3 cells;
  std::array<std::array<Boundary, 2>, 3> boundary;  ///< [axis][lower or upper face]

  bool periodic(int axis) const { return boundary[axis][0] == Boundary::periodic; }
  Real spacing(int axis) const { return (upper[axis] - lower[axis]) / cells[axis]; }
  bool has(Boundary kind) const {
    for (auto const& faces : boundary)
      if (faces[0] == kind || faces[1] == kind) return true;
    return false;
  }
};

}  // namespace amrpic
