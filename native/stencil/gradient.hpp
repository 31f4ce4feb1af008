#pragma once

#include "mesh/window.hpp"
#include "stencil/coarse_end.hpp"
#include "stencil/interface.hpp"

namespace amrpic {

/// What the stencils of a box see of the mesh: the numbers of the cells around it on its own and the neighbouring
/// levels.
struct Neighbourhood {
  Box domain;
  std::array<bool, 3> periodic;
  Real3 spacing;
  WallGhosts walls;
  Real3 seam_width;             ///< of last cells along periodic axes, see `UpperEnd`
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
                                 WallGhosts const& walls, Real3 const& seam_width = {1, 1, 1}) {
  Box const wide = box.grow(2), none;
  Box const parents = coarser ? box.grow(1).coarsen({2, 2, 2}).grow(2) : none;
  auto covered = finer ? covered_cells(*finer, {2, 2, 2}, wide) : Window<char>(wide, 0);
  bool const near = finer && finer->intersects(box.grow(1).refine({2, 2, 2}));
  return {level.domain(),
          level.periodic(),
          level.spacing(),
          walls,
          seam_width,
          cell_numbers(level, wide),
          std::move(covered),
          near ? cell_numbers(*finer, box.grow(1).refine({2, 2, 2})) : Window<GlobalIndex>(none, no_cell),
          coarser ? cell_numbers(*coarser, parents) : Window<GlobalIndex>(none, no_cell),
          coarser ? covered_cells(level, {2, 2, 2}, parents) : Window<char>(none, 0)};
}

/// The coarse cells of the plane behind a coarse-fine face, of which phi* is made.
class PlaneBehind {
 public:
  /// The plane around a cell whose face it is; `covered` has the extent of `cells`.
  PlaneBehind(Index3 const& middle, int axis, Window<GlobalIndex> const& cells, Window<char> const& covered)
      : middle_(middle), along_(tangential_axes(axis)), cells_(cells) {
    auto look = [&](int reach) {
      for (int i = -reach; i <= reach; ++i)
        for (int j = -reach; j <= reach; ++j)
          if (cells(at(i, j)) != no_cell && !covered(at(i, j))) usable_ |= plane_bit(i, j);
    };
    look(1);
    if (usable_ != plane_block(-1, -1, 3)) look(2);  // the central block is the first to be tried
  }

  /// That of the children in the lower or upper half of the cell along either axis of the plane.
  PlaneFit fit(bool upper_u, bool upper_v) const {
    return plane_fit(usable_, upper_u ? 0.25 : -0.25, upper_v ? 0.25 : -0.25);
  }
  GlobalIndex cell(int i, int j) const { return cells_(at(i, j)); }

 private:
  Index3 at(int i, int j) const {
    Index3 out = middle_;
    out[along_[0]] += i;
    out[along_[1]] += j;
    return out;
  }
  Index3 middle_;
  std::array<int, 2> along_;
  Window<GlobalIndex> const& cells_;
  unsigned usable_ = 0;
};

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
    auto const [u, v] = tangential_axes(axis);
    Index3 const behind{floor_divide(outer[0], 2), floor_divide(outer[1], 2), floor_divide(outer[2], 2)};
    PlaneBehind const plane(behind, axis, n.coarse, n.coarse_covered);
    PlaneFit const fit = plane.fit(outer[u] != 2 * behind[u], outer[v] != 2 * behind[v]);
    for (int t = 0; t < fit.count; ++t)
      sink.coarse(plane.cell(fit.terms[t].i, fit.terms[t].j), weight * interface_ghost::coarse * fit.terms[t].weight);
  } else if (execution == Execution::composite && n.covered(outer)) {
    auto const [u, v] = tangential_axes(axis);
    Real const fine_weight = weight * 2 / 4;  // half the spacing, a quarter of the face
    PlaneBehind const plane(cell, axis, n.own, n.covered);
    std::array<std::array<Real, 5>, 5> in_plane{};  // the sum of the four fits
    unsigned taken = 0;
    for (int b = 0; b < 2; ++b)
      for (int a = 0; a < 2; ++a) {
        Index3 first{2 * outer[0], 2 * outer[1], 2 * outer[2]};
        first[axis] += side == 0 ? 1 : 0;
        first[u] += a;
        first[v] += b;
        Index3 second = first;
        second[axis] += step;
        sink.fine(n.fine(first), fine_weight * (1 - interface_ghost::first));
        sink.fine(n.fine(second), -fine_weight * interface_ghost::second);
        PlaneFit const fit = plane.fit(a == 1, b == 1);
        for (int t = 0; t < fit.count; ++t) {
          auto const [i, j, share] = fit.terms[t];
          in_plane[i + 2][j + 2] += share;
          taken |= plane_bit(i, j);
        }
      }
    for (int i = -2; i <= 2; ++i)
      for (int j = -2; j <= 2; ++j)
        if (taken & plane_bit(i, j))
          sink.own(plane.cell(i, j), -fine_weight * interface_ghost::coarse * in_plane[i + 2][j + 2]);
  } else {
    Real const factor = n.periodic[axis] && n.seam_width[axis] != 1
                            ? seam_factor(cell[axis], side, n.domain.extent(axis), n.seam_width[axis])
                            : 1;
    sink.own(n.own(cell), -weight * factor);
    sink.own(n.own(outer), weight * factor);
  }
}

}  // namespace amrpic
