// Places of the padded layout are 32-bit numbers: whether a rank's cells have one each.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "mesh/hierarchy.hpp"

namespace amrpic::cycle {

/// The most places that boxes take in a Layout: rows padded to whole vectors, planes to whole cache lines, with
/// `halo` layers of copies at each box.
std::int64_t padded_cells(std::vector<Box> const& boxes, int halo);

/// Why so many places for a level on a rank are refused; empty if they are not.
std::string refusal_of_places(std::int64_t places, int level, int rank);

/// Throws SolverError, the same on all ranks, if a rank has more padded cells of a level than places. Collective.
void check_places(Hierarchy const& hierarchy, int halo);

}  // namespace amrpic::cycle
