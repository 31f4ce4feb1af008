#pragma once

#include "multigrid/stencil_cells.hpp"

namespace amrpic {

/// What the row of a cell is made of.
enum class RowKind : char {
  regular,  ///< six neighbours of the same level: the same form for all
  special,  ///< the general formula, because a neighbour is missing or twice the same
  beside,   ///< the general formula, because a finer level covers a neighbour
  covered   ///< a finer level covers the cell
};

using RowKinds = ArrayOnBox<RowKind>;

/// Kinds of the rows of a box.
RowKinds row_kinds(StencilCells const& cells, Execution execution);

/// Rows of cells next to each other along x.
struct RowRun {
  LocalIndex row, count;
};

/// Call `f(kind, first cell, run of rows)` for the longest runs of equal kind along x.
template <class F>
void for_each_run(RowKinds const& kinds, LocalIndex first_row, F&& f) {
  Box const& box = kinds.box();
  RowKind const* kind = kinds.values().data();
  LocalIndex row = first_row;
  for (int k = box.lower[2]; k <= box.upper[2]; ++k)
    for (int j = box.lower[1]; j <= box.upper[1]; ++j)
      for (int i = box.lower[0]; i <= box.upper[0];) {
        LocalIndex n = 1;
        while (i + n <= box.upper[0] && kind[n] == kind[0]) ++n;
        f(kind[0], Index3{i, j, k}, RowRun{row, n});
        kind += n, row += n, i += n;
      }
}

/// Call `f(cell, row)` for each cell of a run.
template <class F>
void for_each_in_run(Index3 cell, RowRun const& run, F&& f) {
  for (LocalIndex n = 0; n < run.count; ++n, ++cell[0]) f(cell, run.row + n);
}

}  // namespace amrpic
