// Which cells of other ranks the operators of a level read.
#pragma once

#include "mesh/halo.hpp"
#include "multigrid/multigrid_levels.hpp"

namespace amrpic {

/// Those that the Laplacian without a finer level reads: beyond the six faces of each box.
CellReads stencil_reads(Level const& level);

/// Those of multigrid level l that `no_fine` reads: with fits in narrow gaps more than those.
CellReads relaxation_reads(MultigridLevels const& multigrid, std::size_t l);

/// Those of a level that means over children read, which are made for the cells of `parents`.
void add_children(CellReads& reads, Level const& parents, Index3 const& ratio);

/// Those of multigrid level l that any operator of its own or of a neighbouring level reads.
CellReads operator_reads(MultigridLevels const& multigrid, std::size_t l, Prolongation kind);

/// The parents that prolongation to a box reads, those behind walls included.
Box parents_read(Box const& box, Index3 const& ratio, Prolongation kind);

}  // namespace amrpic
