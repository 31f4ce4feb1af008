// What the row of a cell follows from, besides the numbers of the cells near it.
#pragma once

#include <array>
#include <unordered_map>

#include "mesh/fits_behind.hpp"
#include "mesh/metal_faces.hpp"
#include "multigrid/stencil_cells.hpp"
#include "stencil/gap_fit.hpp"
#include "stencil/odd_extents.hpp"

namespace amrpic {

/// A face of a cell: all that the value across it follows from.
struct FaceShape {
  Beyond beyond = Beyond::same_level;
  bool upper_u = false, upper_v = false;  ///< before coarser cells: in which half of the coarse face it lies
  FitNumber fit = central_fit;            ///< at interfaces
  GapFit const* gap = nullptr;            ///< where that is `fit_in_gap`
  Real seam = 1;                          ///< see `seam_factor`
  MetalFace const* metal = nullptr;       ///< at interfaces that metal makes other than those with fits

  bool operator==(FaceShape const& other) const {
    return beyond == other.beyond && upper_u == other.upper_u && upper_v == other.upper_v && fit == other.fit &&
           gap == other.gap && seam == other.seam && metal == other.metal;
  }
};

/// The faces of a cell, [axis][side].
using CellShape = std::array<std::array<FaceShape, 2>, 3>;

inline FaceShape face_shape(StencilCells const& n, Index3 const& cell, int axis, int side, Execution execution,
                            GapFits& gaps) {
  FaceShape out{n.faces(cell)(axis, side)};
  if (out.beyond == Beyond::finer && execution == Execution::without_finer) out.beyond = Beyond::same_level;
  Index3 middle = cell;  // the coarse cell behind the fine faces
  if (out.beyond == Beyond::coarser) {
    Index3 outer = cell;
    outer[axis] += side == 0 ? -1 : 1;
    middle = parent_of(outer);
    auto const [u, v] = tangential_axes(axis);
    out.upper_u = outer[u] != 2 * middle[u];
    out.upper_v = outer[v] != 2 * middle[v];
  }
  if (out.beyond == Beyond::coarser || out.beyond == Beyond::finer) {
    out.fit = fit_at(out.beyond == Beyond::coarser ? n.coarse_usable : n.usable, middle, axis);
    if (out.fit == fit_in_gap)
      out.gap = &gaps((out.beyond == Beyond::coarser ? n.gaps_behind() : n.gaps_before()).around(middle), axis);
  }
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
                                      (std::size_t(face.fit) << 4 | std::size_t(face.upper_u) << 3 |
                                       std::size_t(face.upper_v) << 2 | std::size_t(face.beyond)) ^
                                      std::hash<GapFit const*>()(face.gap) ^ std::hash<MetalFace const*>()(face.metal));
      return out ^ out >> 32;
    }
  };
  std::unordered_map<CellShape, Made, Hash> made_;
};

}  // namespace amrpic
