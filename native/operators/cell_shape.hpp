// What the row of a cell follows from, besides the numbers of the cells near it.
#pragma once

#include <array>
#include <unordered_map>

#include "mesh/fits_behind.hpp"
#include "operators/stencil_cells.hpp"
#include "stencil/gap_fit.hpp"
#include "stencil/interface.hpp"
#include "stencil/odd_extents.hpp"

namespace amrpic {

/// A face of a cell: all that the value across it follows from.
struct FaceShape {
  Beyond beyond = Beyond::same_level;
  bool upper_u = false, upper_v = false;  ///< before coarser cells: in which half of the coarse face it lies
  int placement = 0;                      ///< at interfaces: see `plane_placement`
  GapFit const* gap = nullptr;            ///< where no placement is complete
  Real seam = 1;                          ///< see `seam_factor`

  bool operator==(FaceShape const& other) const {
    return beyond == other.beyond && upper_u == other.upper_u && upper_v == other.upper_v &&
           placement == other.placement && gap == other.gap && seam == other.seam;
  }
};

/// The faces of a cell, [axis][side].
using CellShape = std::array<std::array<FaceShape, 2>, 3>;

/// The usable cells of the plane around a coarse cell at an interface across an axis, see `plane_bit`; `covered` has
/// the extent of `cells`.
inline unsigned usable_in_plane(Index3 const& middle, int axis, ArrayOnBox<GlobalIndex> const& cells,
                                ArrayOnBox<char> const& covered) {
  auto const [u, v] = tangential_axes(axis);
  Box const& box = cells.box();
  std::ptrdiff_t const place = box.offset(middle), step_u = box.stride(u), step_v = box.stride(v);
  unsigned usable = 0;
  auto look = [&](int reach) {
    for (int i = -reach; i <= reach; ++i)
      for (int j = -reach; j <= reach; ++j) {
        auto const at = std::size_t(place + i * step_u + j * step_v);
        if (cells.values()[at] != no_cell && !covered.values()[at]) usable |= plane_bit(i, j);
      }
  };
  look(1);
  if (usable != plane_block(-1, -1)) look(plane_reach);  // the central block is the first to be tried
  return usable;
}

/// What phi* at an interface is made of, around the coarse cell `middle` behind the fine faces. `cells`, `covered`: of
/// the coarser level, `is_fine(cell)`: whether an uncovered cell of the finer one is there.
template <class IsFine>
void set_fit(FaceShape& face, Index3 const& middle, int axis, ArrayOnBox<GlobalIndex> const& cells,
             ArrayOnBox<char> const& covered, GapFits& gaps, IsFine&& is_fine) {
  face.placement = plane_placement(usable_in_plane(middle, axis, cells, covered));
  if (face.placement >= 0) return;
  auto const is_coarse = [&](Index3 const& cell) { return cells(cell) != no_cell && !covered(cell); };
  face.gap = &gaps(gap_sites(middle, is_coarse, is_fine), axis);
}

inline FaceShape face_shape(StencilCells const& n, Index3 const& cell, int axis, int side, Execution execution,
                            GapFits& gaps) {
  FaceShape out{n.faces(cell)(axis, side)};
  if (out.beyond == Beyond::finer && execution == Execution::without_finer) out.beyond = Beyond::same_level;
  bool const takes_fine = gap_fits_take_fine_cells(*n.level);
  if (out.beyond == Beyond::coarser) {
    Index3 outer = cell;
    outer[axis] += side == 0 ? -1 : 1;
    Index3 const behind = parent_of(outer);
    auto const [u, v] = tangential_axes(axis);
    out.upper_u = outer[u] != 2 * behind[u];
    out.upper_v = outer[v] != 2 * behind[v];
    set_fit(out, behind, axis, n.coarse, n.coarse_covered, gaps, [&](Index3 const& c) {
      return takes_fine && n.around_gaps().own(c) != no_cell && !n.around_gaps().covered(c);
    });
  }
  if (out.beyond == Beyond::finer)
    set_fit(out, cell, axis, n.own, n.covered, gaps,
            [&](Index3 const& c) { return takes_fine && n.fine(c) != no_cell && !n.around_gaps().fine_covered(c); });
  if (n.level->periodic()[axis] && n.seam_width[axis] != 1)
    out.seam = seam_factor(cell[axis], side, n.level->domain().extent(axis), n.seam_width[axis]);
  return out;
}

inline CellShape cell_shape(StencilCells const& n, Index3 const& cell, Execution execution, GapFits& gaps) {
  CellShape out;
  for (int axis = 0; axis < 3; ++axis)
    for (int side = 0; side < 2; ++side) out[axis][side] = face_shape(n, cell, axis, side, execution, gaps);
  return out;
}

/// What is made of shapes, once of each: many cells have the same one.
template <class Made>
class ByShape {
 public:
  template <class Make>
  Made const& operator()(CellShape const& shape, Make&& make) {
    auto const [at, is_new] = made_.try_emplace(shape);
    if (is_new) at->second = make();
    return at->second;
  }

 private:
  struct Hash {
    std::size_t operator()(CellShape const& shape) const {
      std::size_t out = 0;
      for (auto const& axis : shape)
        for (FaceShape const& face : axis)
          out = 0x9e3779b97f4a7c15 * (out ^ out >> 32 ^
                                      (std::size_t(face.placement + 1) << 4 | std::size_t(face.upper_u) << 3 |
                                       std::size_t(face.upper_v) << 2 | std::size_t(face.beyond)) ^
                                      std::hash<GapFit const*>()(face.gap));
      return out ^ out >> 32;
    }
  };
  std::unordered_map<CellShape, Made, Hash> made_;
};

}  // namespace amrpic
