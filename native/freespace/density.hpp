// What free space needs of a mesh: its open walls, and the charges that a field of cells holds.
#pragma once

#include <vector>

#include "freespace/acceptance.hpp"
#include "freespace/charge_blocks.hpp"
#include "freespace/wall_patches.hpp"
#include "mesh/field.hpp"

namespace amrpic::freespace {

/// The uncovered cells of this rank: `factor` (1/eps0, say) times density times cell volume. Lengths are those of
/// `hierarchy`, which has the boxes of the field's own, perhaps stretched. The charges refer to the field. Those in the
/// first layers at Dirichlet walls have the weights of `Options::at_dirichlet_walls`.
std::vector<ChargeBox> charges_of(Field const& density, Hierarchy const& hierarchy, double factor,
                                  Options const& options);

/// The mesh with its open faces, and so many layers of ghosts behind them. All faces of the axis `across` must be open.
WallMesh wall_mesh(Hierarchy const& hierarchy, int layers = 1, Across const& across = {});

}  // namespace amrpic::freespace
