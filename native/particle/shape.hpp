// The clouds that particles are spread into. A shape gives, along one axis, the cells that a particle touches and the
// share of each; deposit and gather use the same shares, so that a particle does not push itself on a uniform grid.
#pragma once

#include <array>
#include <cmath>

#include "base/types.hpp"

namespace amrpic {

/// Uniform cloud of one cell width (linear weighting).
struct CloudInCell {
  static constexpr int width = 2;  ///< cells touched along an axis
  static constexpr int reach = 1;  ///< how far these lie from the particle's own cell

  struct Shares {
    int first;                      ///< leftmost cell touched
    std::array<Real, width> share;  ///< sum to one
  };

  /// Shares of a particle at `x`, in cell widths from the lower face of cell 0.
  static Shares at(Real x) {
    Real const s = x - Real(0.5);  // in cell widths from the centre of cell 0
    Real const left = std::floor(s);
    Real const right_share = s - left;
    return {int(left), {1 - right_share, right_share}};
  }
};

}  // namespace amrpic
