#pragma once

#include <vector>

#include "mesh/hierarchy.hpp"
#include "stencil/wall_ghost.hpp"

namespace amrpic {

/// The wall faces of this rank's cells of a level, numbered as in `for_each_wall`, and the datum given on each: a
/// potential (V) on the face for Dirichlet, an outward derivative (V/m) on the face for Neumann, the potential (V) at
/// the ghost centre for open.
struct Walls {
  struct Face {
    LocalIndex row;
    Index3 cell;
    int axis, side;
    Boundary kind;
  };
  std::vector<Face> faces;
  std::vector<Real> datum;   ///< one per face
  std::vector<Real> second;  ///< behind open walls in fourth order, one per face: of the next ghost outwards, or none

  /// Where a face's datum is taken, in m.
  Real3 position(Domain const& domain, Level const& level, std::size_t face) const;
};

/// The wall faces of a level, with zero data.
Walls find_walls(Domain const& domain, Level const& level);

}  // namespace amrpic
