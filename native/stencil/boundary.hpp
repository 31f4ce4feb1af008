#pragma once

#include "mesh/domain.hpp"

namespace amrpic {

/// The value at a ghost centre behind a wall, from the first and second cell inside and the wall's datum:
/// ghost = first * phi_1 + second * phi_2 + datum * g.
struct WallGhost {
  Real first, second, datum;
};

/// Wall ghosts of levels 0, 1, ...: Dirichlet (g: potential on the face) by the parabola through the face and two
/// cells, Neumann (g: outward derivative) by the central difference, open (g: potential at the ghost centre itself).
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

/// Wall ghosts of all faces, [axis][lower or upper].
using WallGhosts = std::array<std::array<WallGhost, 2>, 3>;

template <class Rule>
WallGhosts wall_ghosts(Domain const& domain, Rule&& rule) {
  WallGhosts out{};
  for (int d = 0; d < 3; ++d)
    for (int side = 0; side < 2; ++side) out[d][side] = rule(domain.boundary[d][side], d);
  return out;
}

}  // namespace amrpic
