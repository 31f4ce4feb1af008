// Conductors on the levels of a cycle.
#pragma once

#include "mesh/metal_faces.hpp"
#include "multigrid/semicoarse.hpp"

namespace amrpic {

/// The levels from `first` on whose cells are a potential's.
std::vector<Level const*> levels_of_potential(MultigridLevels const& multigrid, std::size_t first);

/// The cells of a level in and beside metal, as its equations for corrections have them. In boxes, and perhaps others.
/// Local.
MetalCells metal_on(Metal const& metal, MultigridLevels const& multigrid, std::size_t l, std::vector<Box> const& boxes);
MetalCells metal_on(Metal const& metal, CycleLevels const& levels, std::size_t l, std::vector<Box> const& boxes);

}  // namespace amrpic
