#pragma once

#include "operators/operators.hpp"

namespace amrpic {

/// The stack with multigrid levels put below its base, each the one above with every second cell line taken away along
/// the axes of smallest spacing. It ends after `most` levels, or where such an axis has an odd number of cells, or two.
///
/// Only axes within a factor 1.5 of the smallest spacing are coarsened: a point smoother reduces just those errors that
/// oscillate along the strongly coupled axes.
LevelStack coarsen_below(LevelStack stack, Domain const& domain, int max_grid_size, int most);

}  // namespace amrpic
