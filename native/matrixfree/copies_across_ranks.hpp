#pragma once

#include <array>
#include <vector>

#include "mesh/box_set.hpp"
#include "mesh/faces.hpp"
#include "mesh/reads.hpp"

namespace amrpic::matrixfree {

/// Cells that pass between this rank and another one.
struct CopiedRectangle {
  int rank;
  Box cells;     ///< in the indices of the owner's boxes
  Index3 shift;  ///< added, gives the indices of the copy
};

/// What others have copies of, and what this rank has copies of: by rank, and for each pair of ranks in the same order
/// on both.
struct CopiesAcrossRanks {
  std::vector<CopiedRectangle> asked, wanted;
};

/// The cells that are read across ranks, in few rectangles, which are not joined across seams of the copies. Of a box,
/// one rank has copies of one rectangle that holds all that it reads of it.
CopiesAcrossRanks copies_across_ranks(Reads const& reads, std::array<Seam, 3> const& seams = {});

/// The layers of copied cells beyond which the level ends.
CopiesAcrossRanks at_edges(Level const& level, CopiesAcrossRanks const& copies);

/// Call f(layer) for those of some cells of a level.
template <class F>
void for_each_layer_at_edge(Level const& level, Box const& cells, F&& f) {
  BoxFaces const faces(level, cells);
  for (int d = 0; d < 3; ++d)
    for (int side = 0; side < 2; ++side)
      if (faces.sides[std::size_t(2 * d + side)].has_coarser) f(cells.layer(d, side, 0));
}

}  // namespace amrpic::matrixfree
