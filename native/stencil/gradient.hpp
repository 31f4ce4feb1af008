#pragma once

#include "mesh/window.hpp"
#include "stencil/boundary.hpp"
#include "stencil/interface.hpp"

namespace amrpic {

/// What the stencils of a box see of the mesh: the numbers of the cells around it on its own and the neighbouring
/// levels.
struct Neighbourhood {
  Box domain;
  std::array<bool, 3> periodic;
  Real3 spacing;
  WallGhosts walls;
  Window<GlobalIndex> own;      ///< box grown by 2
  Window<char> covered;         ///< by the next finer level, same extent
  Window<GlobalIndex> fine;     ///< children of the box grown by 1; empty where nothing finer is near
  Window<GlobalIndex> coarse;   ///< parents of the box grown by 1, grown by 2; empty on the base
  Window<char> coarse_covered;  ///< by this level, same extent

  bool behind_wall(Index3 const& cell, int axis) const {
    return !periodic[axis] && (cell[axis] < domain.lower[axis] || cell[axis] > domain.upper[axis]);
  }
};

/// The neighbourhood of a box; `finer` and `coarser` may be null.
inline Neighbourhood look_around(Box const& box, Level const& level, Level const* finer, Level const* coarser,
                                 WallGhosts const& walls) {
  Box const wide = box.grow(2), none;
  Box const parents = coarser ? box.grow(1).coarsen({2, 2, 2}).grow(2) : none;
  auto covered = finer ? covered_cells(*finer, {2, 2, 2}, wide) : Window<char>(wide, 0);
  bool const near = finer && finer->intersects(box.grow(1).refine({2, 2, 2}));
  return {level.domain(),
          level.periodic(),
          level.spacing(),
          walls,
          cell_numbers(level, wide),
          std::move(covered),
          near ? cell_numbers(*finer, box.grow(1).refine({2, 2, 2})) : Window<GlobalIndex>(none, no_cell),
          coarser ? cell_numbers(*coarser, parents) : Window<GlobalIndex>(none, no_cell),
          coarser ? covered_cells(level, {2, 2, 2}, parents) : Window<char>(none, 0)};
}

/// phi* behind a fine ghost cell: emit(coarse cell number, weight) per term of the fit.
template <class Emit>
PlaneFit interpolate_behind(Index3 const& ghost, int axis, Window<GlobalIndex> const& coarse,
                            Window<char> const& coarse_covered, Emit&& emit) {
  auto const [u, v] = tangential_axes(axis);
  Index3 const behind{floor_divide(ghost[0], 2), floor_divide(ghost[1], 2), floor_divide(ghost[2], 2)};
  auto at = [&](int i, int j) {
    Index3 cell = behind;
    cell[u] += i;
    cell[v] += j;
    return cell;
  };
  unsigned usable = 0;
  auto look = [&](int reach) {
    for (int i = -reach; i <= reach; ++i)
      for (int j = -reach; j <= reach; ++j)
        if (coarse(at(i, j)) != no_cell && !coarse_covered(at(i, j))) usable |= plane_bit(i, j);
  };
  look(1);
  if (usable != plane_block(-1, -1, 3)) look(2);  // the central block is the first to be tried
  auto offset = [&](int axis_in_plane) { return ghost[axis_in_plane] == 2 * behind[axis_in_plane] ? -0.25 : 0.25; };
  PlaneFit const fit = plane_fit(usable, offset(u), offset(v));
  for (int t = 0; t < fit.count; ++t) emit(coarse(at(fit.terms[t].i, fit.terms[t].j)), fit.terms[t].weight);
  return fit;
}

enum class Execution { without_finer, composite };

/// The outward derivative of phi through one face of a cell, times `scale`, as terms of the linear form:
/// sink.own(cell number, weight), sink.coarse(...), sink.fine(...).
///
/// Both Laplacian (sum over faces of scale = 1/h) and field (scale = -+1/2) are made of it, so that every face has one
/// flux. In `composite` execution the flux through a face that the finer level covers on the other side is the mean of
/// the four fine fluxes; the cell itself must then be uncovered.
template <class Sink>
void outward_gradient(Neighbourhood const& n, Index3 const& cell, int axis, int side, Execution execution, Real scale,
                      Sink&& sink) {
  int const step = side == 0 ? -1 : 1;
  Real const weight = scale / n.spacing[axis];
  Index3 outer = cell, inner = cell;
  outer[axis] += step;
  inner[axis] -= step;

  if (n.behind_wall(outer, axis)) {
    WallGhost const& ghost = n.walls[axis][side];
    sink.own(n.own(cell), weight * (ghost.first - 1));
    if (ghost.second != 0) sink.own(n.own(inner), weight * ghost.second);
  } else if (n.own(outer) == no_cell) {
    sink.own(n.own(cell), weight * (interface_ghost::first - 1));
    sink.own(n.own(inner), weight * interface_ghost::second);
    interpolate_behind(outer, axis, n.coarse, n.coarse_covered,
                       [&](GlobalIndex c, Real w) { sink.coarse(c, weight * interface_ghost::coarse * w); });
  } else if (execution == Execution::composite && n.covered(outer)) {
    auto const [u, v] = tangential_axes(axis);
    Real const fine_weight = weight * 2 / 4;  // half the spacing, a quarter of the face
    for (int b = 0; b < 2; ++b)
      for (int a = 0; a < 2; ++a) {
        Index3 first{2 * outer[0], 2 * outer[1], 2 * outer[2]};
        first[axis] += side == 0 ? 1 : 0;
        first[u] += a;
        first[v] += b;
        Index3 second = first, ghost = first;
        second[axis] += step;
        ghost[axis] -= step;
        sink.fine(n.fine(first), fine_weight * (1 - interface_ghost::first));
        sink.fine(n.fine(second), -fine_weight * interface_ghost::second);
        interpolate_behind(ghost, axis, n.own, n.covered,
                           [&](GlobalIndex c, Real w) { sink.own(c, -fine_weight * interface_ghost::coarse * w); });
      }
  } else {
    sink.own(n.own(cell), -weight);
    sink.own(n.own(outer), weight);
  }
}

}  // namespace amrpic
