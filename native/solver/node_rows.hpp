#pragma once

#include "fem/block_rows.hpp"
#include "solver/point_equations.hpp"

namespace amrpic {

/// Rows of nodes as compressed ones; fixed unknowns have ones on the diagonal. Local.
SharedRows compressed(fem::NodeBlocks const& blocks);

}  // namespace amrpic
