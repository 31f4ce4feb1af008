// What free space needs of a mesh: its open walls, and the charges that a field of cells holds.
#pragma once

#include <vector>

#include "freespace/charge_blocks.hpp"
#include "freespace/wall_patches.hpp"
#include "mesh/field.hpp"

namespace amrpic::freespace {

/// The uncovered cells of this rank: `factor` (1/eps0, say) times density times cell volume. Lengths are those of
/// `hierarchy`, which has the boxes of the field's own, perhaps stretched. The charges refer to the field.
std::vector<ChargeBox> charges_of(Field const& density, Hierarchy const& hierarchy, double factor);

/// The mesh with its open faces, and so many layers of ghosts behind them.
WallMesh wall_mesh(Hierarchy const& hierarchy, int layers = 1);

}  // namespace amrpic::freespace
