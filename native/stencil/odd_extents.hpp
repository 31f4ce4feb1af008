#pragma once

#include <cmath>

#include "stencil/intergrid.hpp"
#include "stencil/wall_ghost.hpp"

namespace amrpic {

// Multigrid levels below the base pair cells by their indices: cell I of the coarser level has the children 2I and
// 2I + 1. Along an axis with an odd number of cells the last pair is half empty, so that from there on a level ends
// elsewhere than at a face of its cells. Lower ends are always ordinary.

/// Where a level ends at the upper side of an axis, in units of its spacing.
struct UpperEnd {
  Real wall = 0.5;  ///< from the last centre to a Dirichlet or open wall
  Real width = 1;   ///< of the last cell at a Neumann wall or a periodic seam: less where half a pair is missing

  bool operator==(UpperEnd const& other) const { return wall == other.wall && width == other.width; }
  bool operator!=(UpperEnd const& other) const { return !(*this == other); }
};

struct CoarseAxis {
  int cells;
  UpperEnd end;
};

/// The coarser level's cells along an axis with `cells` cells, and where it ends.
///
/// Where the correction vanishes at a wall, or `behind` spacings behind an open one, half a pair is kept as a whole
/// cell if that place is at least a quarter of a spacing from its centre, else it is dropped. Elsewhere it is kept as a
/// finite volume of its own width.
inline CoarseAxis coarsened(int cells, UpperEnd const& end, Boundary upper, Real behind) {
  if (cells % 2 == 0) return {cells / 2, {(end.wall + 0.5) / 2, (end.width + 1) / 2}};
  if (upper == Boundary::neumann || upper == Boundary::periodic) return {(cells + 1) / 2, {0.5, end.width / 2}};
  Real const kept = (end.wall - 0.5) / 2;
  return kept + behind / 2 >= 0.25 ? CoarseAxis{(cells + 1) / 2, {kept, 1}}
                                   : CoarseAxis{(cells - 1) / 2, {(end.wall + 1.5) / 2, 1}};
}

/// Whether no wall along an axis keeps corrections from being constant there. Such axes are coarsened down to one cell,
/// since relaxing does not reduce what is constant along them.
inline bool is_closed(std::array<Boundary, 2> const& ends) {
  return ends[0] == Boundary::periodic || (ends[0] == Boundary::neumann && ends[1] == Boundary::neumann);
}

/// Whether an axis with so many cells is coarsened further.
inline bool can_be_coarsened(int cells, std::array<Boundary, 2> const& ends) {
  return cells > (is_closed(ends) ? 1 : 2);
}

/// Wall ghosts of corrections on multigrid levels along the axes that these coarsen: the correction vanishes on a
/// Dirichlet face; no flux passes a Neumann face, whose last cell has a width of its own. Behind an open face it
/// vanishes at a distance of its own (see OpenWalls). A single cell around a periodic axis is its own neighbour and
/// exchanges nothing; its level is not periodic any more.
inline WallGhost coarse_wall_ghost(Boundary kind, int cells, UpperEnd const& end) {
  switch (kind) {
    case Boundary::dirichlet:
      return {ghost_that_vanishes(end.wall), 0.0, 0.0};
    case Boundary::neumann:
      // (inner - last) / width, as inner - 2 last + ghost
      return cells == 1 ? WallGhost{1.0, 0.0, 0.0} : WallGhost{2 - 1 / end.width, 1 / end.width - 1, 0.0};
    case Boundary::periodic:
      return {1.0, 0.0, 0.0};
    case Boundary::open:
      break;
  }
  return {0.0, 0.0, 0.0};
}

/// The same for prolongation, which is linear up to the wall, or constant where no flux passes.
inline Real prolonged_wall_ghost(Boundary kind, UpperEnd const& end) {
  return kind == Boundary::dirichlet ? ghost_that_vanishes(end.wall) : kind == Boundary::open ? 0 : 1;
}

/// Factor of the difference to the neighbour of cell i on a side, along a periodic axis whose last of n cells has a
/// width of its own: finite volumes, over that of ordinary cells. Indices outside the axis are those of images.
KOKKOS_INLINE_FUNCTION Real seam_factor(int i, int side, int n, Real width) {
  auto const is_last = [n](int c) { return ((c + 1) % n + n) % n == 0; };
  Real const distance = (1 + width) / 2;
  if (is_last(i)) return 1 / (width * distance);
  return is_last(side == 0 ? i - 1 : i + 1) ? 1 / distance : 1;
}

/// What a child of cell i takes of the neighbour on its side along such an axis: linear towards the last cell, constant
/// in it.
KOKKOS_INLINE_FUNCTION Real prolonged_far(int i, int side, int n, Real width) {
  bool const in_last = width != 1 && ((i + 1) % n + n) % n == 0;
  return in_last ? 0 : prolongation::far * seam_factor(i, side, n, width);
}

/// The value across a face towards the last cell of such an axis, as an ordinary face's.
template <class Value>
inline Value neighbour_at_seam(Real factor, Value const& inner, Value const& outer) {
  return factor * outer + (1 - factor) * inner;
}

/// Widths of the last cells along periodic axes; ones along others.
inline Real3 seam_widths(std::array<bool, 3> const& periodic, std::array<UpperEnd, 3> const& upper) {
  Real3 out{1, 1, 1};
  for (int d = 0; d < 3; ++d)
    if (periodic[d]) out[d] = upper[d].width;
  return out;
}

/// What the last child but one and the last one of an axis weigh in their parent's mean, over what others do: finite
/// volumes where the last has a width of its own.
struct LastChildren {
  Real before = 1, last = 1;
};
inline LastChildren last_children(int cells, UpperEnd const& end, Boundary upper) {
  if (upper != Boundary::neumann && upper != Boundary::periodic) return {};
  if (cells % 2 != 0) return {1, 2};
  return {2 / (1 + end.width), 2 * end.width / (1 + end.width)};
}

}  // namespace amrpic
