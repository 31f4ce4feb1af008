// The potential behind open walls beside lattices of images, axis by axis.
//
// The lattice Green's function is an integral over time of products of heat kernels, one per axis. So is its sum over
// images, since their maps are products too; along an axis that repeats it is the kernel of a ring of cells. At each of
// some hundred times, the charge is multiplied by a matrix along the normal of a wall, then by one along each axis of
// its plane. So the cost goes with the number of cells, whatever shape they have and however many images are near, and
// nothing is left out: neither far images nor, between conductors, what their signs leave.
#pragma once

#include <vector>

#include "freespace/wall_plan.hpp"

namespace amrpic::freespace {

/// Potential at the ghosts of this rank's blocks, in the order of `WallPlan::place`; lengths in units of the smallest
/// spacing. `charges`: of all cells of all levels, in the order of their boxes. Local; a value depends on nothing but
/// charge and its place.
std::vector<double> sums_by_axes(WallPlan const& plan, Options const& options, std::vector<double> const& charges,
                                 Which which);

}  // namespace amrpic::freespace
