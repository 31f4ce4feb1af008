// Rows of cells along x, and what lies beside them: what acts on rows are given.
#pragma once

#include <array>
#include <cstddef>

#include "base/kokkos.hpp"
#include "stencil/laplacian.hpp"
#include "stencil/relaxation.hpp"

namespace amrpic::cycle {

/// A row of a correction and its neighbours: the rows beside it, and the cells before and after it.
struct CorrectionRow {
  float* here;
  std::array<float const*, 4> beside;  ///< y below, above, z below, above
  float left, right;
  int vectors;  ///< of N cells
  int last;     ///< lane of the last cell in the last vector
};

/// A row and its neighbours for a residual of differences: `left` and `right` are differences, and so are the rows
/// beside it less those of `less`.
struct DifferenceRow : CorrectionRow {
  std::array<float const*, 4> less;
  int cells;

  KOKKOS_INLINE_FUNCTION float remaining(std::array<float, 3> const& weight, float r, float held, int i) const {
    float const e = here[i];
    float const before = i > 0 ? here[i - 1] - e : left, after = i + 1 < cells ? here[i + 1] - e : right;
    auto across = [&](std::size_t side) {
      return (beside[side][i] - less[side][i]) + (beside[side + 1][i] - less[side + 1][i]);
    };
    return amrpic::remaining(r, weighted_sum(weight, before + after, across(0), across(2)), held, e);
  }
};
/// One, two or four rows of a coarser level, and what a fine row takes of each; `row` points at the first parent.
struct CoarseRows {
  std::array<float const*, 4> row;
  std::array<float, 4> weight;
  int count;
};

/// The weighted sum over coarse rows at one place.
KOKKOS_INLINE_FUNCTION float mean(CoarseRows const& coarse, int place) {
  float sum = 0;
  for (std::size_t c = 0; c < 4; ++c)
    if (int(c) < coarse.count) sum += coarse.weight[c] * coarse.row[c][place];
  return sum;
}

}  // namespace amrpic::cycle
