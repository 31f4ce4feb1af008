#pragma once

#include <functional>

#include "base/kokkos.hpp"
#include "matrixfree/ghosts.hpp"
#include "matrixfree/row_kernels.hpp"

namespace amrpic::matrixfree {

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

  KOKKOS_INLINE_FUNCTION int parent(int axis, int i) const { return (i + odd[axis]) / ratio[axis]; }
  bool is_first_child(int axis, int i) const { return i == 0 || (i + odd[axis]) % ratio[axis] == 0; }
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
};

/// The colours of cells, and both of them: numbers that can be joined by |.
constexpr int colour_bit(int colour) { return 1 << colour; }
constexpr int both_colours = 3;

/// What is done to one plane of one block: to all its rows, or where stages follow each other level by level to some.
struct PlaneStage {
  std::function<void(std::size_t block, int plane, RowChoice const& rows)> act;
  int reads = 0;    ///< colours of neighbours whose corrections are read
  int changes = 0;  ///< colours of corrections that are changed
};

/// Run stages over all planes of a layout in one pass: stage s of a plane comes after stage s - 1 of the plane above
/// it, so that a plane stays in the cache from the first stage to the last. Plane after plane, `before` is called
/// before a stage reaches it.
void wavefront(Layout const& layout, std::vector<PlaneStage> const& stages, std::function<void(int)> const& before);

/// The acts on one plane of a block (k in the level's indices), vectorised along x.
class Sweep {
 public:
  Sweep(Layout const& layout, Stencil const& stencil);

  /// One colour (0 or 1: the parity of i + j + k) relaxed from zero; the other becomes zero.
  void relax_from_zero(std::size_t block, int k, int colour, RowChoice const& rows, Vector const& r, Vector& e) const;
  void relax(std::size_t block, int k, int colour, RowChoice const& rows, Vector const& r, Vector& e) const;

  /// What a plane adds to the coarse right-hand side: `weight` times the sum of the children's residuals, or of their
  /// right-hand sides. The first of the planes that share parents sets, the others add.
  void restrict_residual(std::size_t block, int k, Vector const& r, Vector const& e, Parents const& parents,
                         float weight, Vector& coarse) const;

  void restrict_right_hand_side(std::size_t block, int k, Vector const& r, Parents const& parents, float weight,
                                Vector& coarse) const;

  /// Set e to the coarse correction, interpolated trilinearly along the axes of ratio 2, or add this; ghost
  /// cells of the block's parents must be filled. Sweeps that follow read r.
  void prolong(std::size_t block, int k, RowChoice const& rows, Parents const& parents, Vector const& coarse, bool set,
               Vector const& r, Vector& e) const;

 private:
  template <int lanes>
  void restrict_row(CellBlock const& block, int j, int k, float const* fine, Parents const& parents, float weight,
                    Vector& coarse) const;
  float const* in_pairs(CellBlock const& block, Parents const& parents, float* line) const;
  float* line_of(Parents const& parents) const { return buffer_[4].data() + 16 + parents.odd[0]; }
  template <class F>
  void for_each_row(std::size_t block, int k, RowChoice const& rows, float* e, F&& f) const;
  float const* composed(BlockStencil const& stencil, std::int32_t beside, float const* e, Vector& buffer,
                        bool differences = false) const;
  DifferenceRow in_differences(std::size_t block, RowStencil const& stencil, CorrectionRow const& row,
                               float const* e) const;

  Layout const& layout_;
  Stencil const& stencil_;
  mutable std::array<Vector, 5> buffer_;  ///< rows beside a row, and a residual or a correction
};

}  // namespace amrpic::matrixfree
