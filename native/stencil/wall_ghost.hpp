#pragma once

#include "base/kokkos.hpp"
#include "base/types.hpp"

namespace amrpic {

/// What the potential meets at a face of the domain.
enum class Boundary { open, dirichlet, neumann, periodic };

/// The value at a ghost centre behind a wall, from the first and second cell inside and the wall's datum.
struct WallGhost {
  Real first, second, datum;

  template <class Value>
  KOKKOS_INLINE_FUNCTION Value operator()(Value const& phi_1, Value const& phi_2, Value const& given) const {
    return first * phi_1 + second * phi_2 + datum * given;
  }
  /// With a datum of zero.
  template <class Value>
  Value operator()(Value const& phi_1, Value const& phi_2) const {
    return first * phi_1 + second * phi_2;
  }
};

/// Wall ghosts of levels 0, 1, ...: Dirichlet (datum: potential on the face) by the parabola through the face and two
/// cells, Neumann (outward derivative) by the central difference, open (potential at the ghost centre itself).
inline WallGhost wall_ghost(Boundary kind, Real spacing) {
  switch (kind) {
    case Boundary::dirichlet:
      return {-2.0, 1.0 / 3.0, 8.0 / 3.0};
    case Boundary::neumann:
      return {1.0, 0.0, spacing};
    case Boundary::open:
      return {0.0, 0.0, 1.0};
    case Boundary::periodic:
      break;
  }
  return {0.0, 0.0, 0.0};
}

/// Factor of the last cell in the ghost of a correction that vanishes `distance` spacings behind its centre.
inline Real ghost_that_vanishes(Real distance) { return 1 - 1 / distance; }

/// Wall ghosts of all faces, [axis][lower or upper].
using WallGhosts = std::array<std::array<WallGhost, 2>, 3>;

}  // namespace amrpic
