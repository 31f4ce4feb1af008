#pragma once

#include "mesh/window.hpp"

namespace amrpic {

enum class Prolongation { constant, trilinear };

/// A fine cell's value from the coarser level, as emit(coarse cell number, weight): its parent's, or trilinear with 3/4
/// for the parent and 1/4 for the neighbour on the cell's side along each refined axis. A neighbour behind a wall is
/// `wall(parent, axis, side)` times the parent.
template <class Wall, class Emit>
void prolong(Index3 const& cell, Index3 const& ratio, Prolongation kind, Window<GlobalIndex> const& coarse,
             Box const& coarse_domain, std::array<bool, 3> const& periodic, Wall&& wall, Emit&& emit) {
  Index3 parent, step{0, 0, 0};
  Real3 near{1, 1, 1}, far{0, 0, 0};
  for (int d = 0; d < 3; ++d) parent[d] = floor_divide(cell[d], ratio[d]);
  for (int d = 0; d < 3; ++d) {
    if (kind == Prolongation::constant || ratio[d] == 1) continue;
    int const side = cell[d] - 2 * parent[d];
    int const neighbour = parent[d] + 2 * side - 1;
    if (!periodic[d] && (neighbour < coarse_domain.lower[d] || neighbour > coarse_domain.upper[d])) {
      near[d] = 0.75 + 0.25 * wall(parent, d, side);
    } else {
      near[d] = 0.75, far[d] = 0.25, step[d] = 2 * side - 1;
    }
  }
  for (int corner = 0; corner < 8; ++corner) {
    Real weight = 1;
    Index3 source = parent;
    for (int d = 0; d < 3; ++d) {
      bool const other = (corner >> d) & 1;
      weight *= other ? far[d] : near[d];
      if (other) source[d] += step[d];
    }
    if (weight != 0) emit(coarse(source), weight);
  }
}

/// A covered cell's value as the mean of its children: emit(fine cell number, weight).
template <class Emit>
void restrict_mean(Index3 const& cell, Index3 const& ratio, Window<GlobalIndex> const& fine, Emit&& emit) {
  Real const weight = 1.0 / (ratio[0] * ratio[1] * ratio[2]);
  Box const children = Box{cell, cell}.refine(ratio);
  for_each_cell(children, [&](Index3 const& child) { emit(fine(child), weight); });
}

}  // namespace amrpic
