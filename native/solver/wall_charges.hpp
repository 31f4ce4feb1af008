#pragma once

#include <vector>

#include "freespace/acceptance.hpp"
#include "freespace/charge_blocks.hpp"
#include "freespace/plates.hpp"
#include "mesh/hierarchy.hpp"
#include "mesh/walls.hpp"

namespace amrpic {

/// What open faces see of the data on walls beside them: a density (C/m^3) in the first layers of cells at these, by
/// box of this rank over all levels; empty if there is none. Of potentials it is what they are above those `beyond`
/// their faces (V). It has the weights of `Options::at_dirichlet_walls`. Local.
std::vector<std::vector<freespace::ChargeBox::Added>> wall_charges(Hierarchy const& hierarchy,
                                                                   std::vector<Walls> const& walls,
                                                                   freespace::PerFace const& beyond,
                                                                   freespace::Options const& options);

}  // namespace amrpic
