#pragma once

#include "matrixfree/sweep.hpp"

namespace amrpic::matrixfree {

/// The acts of `Sweep` as Kokkos kernels: a team per row, cells of a row as its vector range, ghost rows in the team's
/// scratch memory. They run on whatever Kokkos' host space was built for; a test compares both forms.
namespace portable {

/// A plane of a block, and all that a kernel reads of it.
struct Plane {
  CellBlock const& block;
  BlockStencil const& ghosts;
  Stencil const& stencil;
  int k;           ///< in the level's indices
  RowChoice rows;  ///< that are relaxed or take corrections

  int number() const { return k - block.box.lower[2]; }  ///< in the block
};

void relax_from_zero(Plane const& plane, int colour, float const* r, float* e);
void relax(Plane const& plane, int colour, float const* r, float* e);
void restrict_residual(Plane const& plane, float const* r, float const* e, Parents const& parents, float weight,
                       float* coarse);
void restrict_right_hand_side(Plane const& plane, float const* r, Parents const& parents, float weight, float* coarse);
void prolong(Plane const& plane, Parents const& parents, float const* coarse, bool set, float* e);

}  // namespace portable
}  // namespace amrpic::matrixfree
