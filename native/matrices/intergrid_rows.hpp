#pragma once

#include "mesh/halo.hpp"
#include "stencil/odd_extents.hpp"

namespace amrpic {

/// Between a parent and its neighbours, along each axis one of them.
struct Trilinear {
  Index3 parent, step{0, 0, 0};  ///< step: to the neighbour
  Real3 near{1, 1, 1}, far{0, 0, 0};

  /// Let the neighbour on the side of a cell take part along an axis.
  void interpolate(Index3 const& cell, int axis, Level const& coarser, Real seam_width) {
    int const side = cell[axis] - 2 * parent[axis];
    far[axis] = coarser.periodic()[axis] ? prolonged_far(parent[axis], side, coarser.domain().extent(axis), seam_width)
                                         : prolongation::far;
    near[axis] = 1 - far[axis], step[axis] = 2 * side - 1;
  }

  /// Call f(coarse cell, weight) where weights are not zero.
  template <class F>
  void for_each(F&& f) const {
    for (int corner = 0; corner < 8; ++corner) {
      Real weight = 1;
      Index3 source = parent;
      for (int d = 0; d < 3; ++d) {
        bool const other = (corner >> d) & 1;
        weight *= other ? far[d] : near[d];
        if (other) source[d] += step[d];
      }
      if (weight != 0) f(source, weight);
    }
  }
};

/// A fine cell's value from the coarser level, as emit(coarse cell, weight): its parent's, or trilinear between
/// the parent and the neighbour on the cell's side along each refined axis. A cell behind a wall, neighbour
/// or parent, is `wall(cell before it, axis, side)` times that before it. `seam_width`: of the coarser level's last
/// cells along periodic axes.
template <class Wall, class Emit>
void prolong(Index3 const& cell, Index3 const& ratio, Prolongation kind, Level const& coarser, Real3 const& seam_width,
             Wall&& wall, Emit&& emit) {
  Trilinear at{Box{cell, cell}.coarsen(ratio).lower};
  for (int d = 0; d < 3; ++d) {
    if (ratio[d] == 1) continue;
    if (coarser.is_behind_wall(at.parent, d)) {
      at.parent[d] = coarser.domain().upper[d];
      at.near[d] = prolonged(wall(at.parent, d, 1), Real(1));
      continue;
    }
    if (kind == Prolongation::constant) continue;
    int const side = cell[d] - 2 * at.parent[d];
    if (coarser.is_at_wall({at.parent, at.parent}, d, side))
      at.near[d] = prolonged(Real(1), wall(at.parent, d, side));
    else
      at.interpolate(cell, d, coarser, seam_width[d]);
  }
  at.for_each(emit);
}

/// A cell's value as the mean of its children, those that exist: emit(fine cell, weight). `places`: of the finer
/// level's cells. `last`: what that level's last cells weigh.
template <class Emit>
void restrict_mean(Index3 const& cell, Index3 const& ratio, Level const& fine, ArrayOnBox<LocalIndex> const& places,
                   std::array<LastChildren, 3> const& last, Emit&& emit) {
  Index3 const end = fine.domain().upper;
  for_each_cell(Box{cell, cell}.refine(ratio), [&](Index3 const& child) {
    if (!fine.domain().contains(child) || places(child) == no_place) return;
    Real weight = mean_weight(ratio);
    for (int d = 0; d < 3; ++d)
      weight *= child[d] == end[d] ? last[d].last : child[d] + 1 == end[d] ? last[d].before : 1;
    emit(child, weight);
  });
}

}  // namespace amrpic
