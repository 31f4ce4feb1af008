#pragma once

#include "cycle/layout.hpp"
#include "cycle/rows.hpp"
#include "stencil/odd_extents.hpp"

namespace amrpic::cycle {

/// Where the parents of a block's cells lie in another Vector.
struct Parents {
  Placement cells;  ///< the parent of the block's lower corner, and the pitches
  Index3 ratio;
  Index3 odd{0, 0, 0};      ///< 1 along axes where the block's lower corner is the second child of its parent
  Index3 extent;            ///< parents that take residuals
  Index3 last{-1, -1, -1};  ///< place in the block of the level's last cell, where children weigh otherwise
  std::array<LastChildren, 3> weight;  ///< that and the one before it
  Index3 first{0, 0, 0};               ///< index of the parent of the lower corner
  Index3 seam{0, 0, 0};                ///< parents around a periodic axis whose last one has a width of its own, else 0
  Real3 seam_width{1, 1, 1};

  /// A number of cells over the ratio, which is 1 or 2, without a division.
  KOKKOS_INLINE_FUNCTION int over_ratio(int axis, int i) const { return i >> (ratio[axis] - 1); }
  KOKKOS_INLINE_FUNCTION int parent(int axis, int i) const { return over_ratio(axis, i + odd[axis]); }
  // The children of a parent, of n cells in the block.
  KOKKOS_INLINE_FUNCTION int first_child(int axis, int p) const { return p == 0 ? 0 : p * ratio[axis] - odd[axis]; }
  KOKKOS_INLINE_FUNCTION int end_of_children(int axis, int p, int n) const {
    int const end = (p + 1) * ratio[axis] - odd[axis];
    return end < n ? end : n;
  }
  /// Where between parents a cell lies: its other parent along an axis is the next lower or higher one, or there is
  /// none.
  KOKKOS_INLINE_FUNCTION int toward(int axis, int i) const {
    return ratio[axis] == 1 ? 0 : (i + odd[axis]) % 2 == 0 ? -1 : 1;
  }
  /// What it takes of that one.
  KOKKOS_INLINE_FUNCTION float far(int axis, int i) const {
    int const side = toward(axis, i);
    if (seam[axis] == 0 || side == 0) return side == 0 ? 0.0f : float(prolongation::far);
    return float(prolonged_far(first[axis] + parent(axis, i), (side + 1) / 2, seam[axis], seam_width[axis]));
  }
  /// What a child weighs in its parent's mean, over what others do.
  KOKKOS_INLINE_FUNCTION float weight_of(int axis, int i) const {
    return i == last[axis] ? float(weight[axis].last) : i + 1 == last[axis] ? float(weight[axis].before) : 1.0f;
  }
  /// Row (j, k) lies between its parents' row and the next ones on its own side.
  KOKKOS_INLINE_FUNCTION CoarseRows rows_of(int j, int k, float const* values) const {
    float const* const here = values + cells.place(0, parent(1, j), parent(2, k));
    int const y = toward(1, j), z = toward(2, k);
    float const far_y = far(1, j), far_z = far(2, k), near_y = 1 - far_y, near_z = 1 - far_z;
    auto const step_y = y * cells.pitch_y, step_z = z * cells.pitch_z;
    bool const along_y = y != 0;  // no number is a place in an array: a card would keep that in memory
    return {{here, here + (along_y ? step_y : step_z), here + step_z, here + step_y + step_z},
            {near_y * near_z, along_y ? far_y * near_z : near_y * far_z, near_y * far_z, far_y * far_z},
            (along_y ? 2 : 1) * (z != 0 ? 2 : 1)};
  }
};

}  // namespace amrpic::cycle
