#pragma once

#include "operators/operators.hpp"

namespace amrpic::matrixfree {

/// The stack with multigrid levels put below its base, each the one above with every second cell line taken away along
/// the axes of smallest spacing; it ends where no such axis has an even number of more than two cells.
///
/// Boxes stay on their ranks as long as they can be halved; small levels, and the last, are held whole by every rank
/// (a Level of one rank), which costs one sum over the ranks instead of a message per sweep.
LevelStack coarsen_in_place(LevelStack stack, Domain const& domain);

}  // namespace amrpic::matrixfree
