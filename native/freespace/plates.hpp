// The potential between plates without end, each at a constant one: how Dirichlet walls go on beyond open faces.
#pragma once

#include <vector>

#include "mesh/domain.hpp"

namespace amrpic::freespace {

/// One value for each face, [axis][lower or upper].
using PerFace = std::array<std::array<Real, 2>, 3>;

/// The Dirichlet faces of a domain as plates that reach as far as other plates let them; Neumann faces reflect them.
///
/// What spreads from a place by diffusion meets plate after plate, and the potential there is the mean of those of the
/// plates by how much each one gets. As it spreads along each axis by itself, a plate's part is the integral over time
/// of the rate at which it is met along its axis times what is left along the others. So these functions of one
/// coordinate serve planes, edges, corners, strips and pipes; the integral over the logarithm of time is a sum, exact
/// to 1e-13.
class Plates {
 public:
  /// `potentials` in V. Places will be as far from plates as `nearest` (m) at least.
  Plates(Domain const& domain, PerFace const& potentials, Real nearest);

  /// The potential (V) at some places (m), or its mean over boxes around them, from the two points of Gauss's
  /// quadrature along each axis, `from_centre` (m) off; zero where there are no plates.
  std::vector<Real> at(std::vector<Real3> const& places, Real3 const& from_centre) const;

 private:
  /// The plates across an axis: at `origin`, and one more `length` away if that is not zero.
  struct Axis {
    bool has_plates = false;
    Real origin = 0, direction = 1, length = 0;
    std::array<Real, 2> potential{};
  };
  /// At each time: what has met no plate, and what meets them, times their potentials above the lowest one.
  struct Spread {
    std::vector<Real> left, met;
  };
  Spread spread(Axis const& axis, Real x, Real from_centre) const;

  std::array<Axis, 3> axes_;
  Real lowest_ = 0, highest_ = 0;
  std::vector<Real> times_;  ///< m^2: of a diffusivity of 1
};

}  // namespace amrpic::freespace
