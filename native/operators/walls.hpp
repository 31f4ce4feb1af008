#pragma once

#include <vector>

#include "mesh/hierarchy.hpp"
#include "stencil/boundary.hpp"
#include "stencil/equation.hpp"

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

/// f -= what the data add to the Laplacian.
void subtract_from_laplacian(Walls const& walls, WallGhosts const& ghosts, Equation const& equation,
                             std::vector<Real>& f);

/// e += what the data add to -grad phi along an axis, in cells whose entry in `uncovered` is `which`.
void add_to_field(Walls const& walls, WallGhosts const& ghosts, Real3 const& spacing, int axis,
                  std::vector<char> const& uncovered, bool which, Real* e);

}  // namespace amrpic
