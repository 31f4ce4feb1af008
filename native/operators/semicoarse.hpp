#pragma once

#include <mpi.h>

#include "operators/operators.hpp"

namespace amrpic {

/// The ghosts of a refinement level's corrections, at walls and beyond its own cells, while it is coarsened by itself.
struct CorrectionGhosts {
  WallGhosts wall;
  std::array<WallGhost, 3> interface;
  std::array<std::array<Real, 2>, 3> wall_zero;  ///< distance behind the face at which corrections vanish, m
  Real3 interface_zero;                          ///< the same where the level ends
};

/// Those of the level itself.
CorrectionGhosts correction_ghosts(Level const& level, WallGhosts const& walls,
                                   std::array<std::array<Boundary, 2>, 3> const& boundary);

/// Whether the cells of a level are so long or flat, more than 2 to 1, that relaxing points is not enough to smooth it.
bool has_long_cells(Level const& level);

/// By how much to coarsen each axis of a refinement level by itself: 2 along the axes of smallest spacing while another
/// spacing is more than twice that; all ones where it is not, or where the boxes do not allow it.
Index3 semicoarsening_of(Level const& level);

/// The boxes of a level with fewer cells along some axes, on the same ranks in the same order. `ghosts` become those of
/// the coarser level.
std::shared_ptr<Level const> semicoarse_level(Level const& level, Index3 const& ratio, CorrectionGhosts& ghosts);

/// The same with its operators, of which `no_fine` and the halo alone are made. `ghosts` become those of the coarser
/// level. Collective.
LevelOperators semicoarsened(MPI_Comm comm, Level const& level, Index3 const& ratio, CorrectionGhosts& ghosts);

}  // namespace amrpic
