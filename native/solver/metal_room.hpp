#pragma once

#include "mesh/hierarchy.hpp"
#include "mesh/metal.hpp"

namespace amrpic {

/// Throws SolverError on all ranks for metal that meets an open face. Collective.
void require_room_around(Metal const& metal, Hierarchy const& hierarchy, Real3 const& stretch);

}  // namespace amrpic
