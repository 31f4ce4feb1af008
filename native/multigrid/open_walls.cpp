#include "multigrid/open_walls.hpp"

#include <algorithm>

namespace amrpic {

OpenWalls::OpenWalls(MultigridLevels const& multigrid) : multigrid_(multigrid) {
  auto const is_open = [](auto const& sides) { return std::count(sides.begin(), sides.end(), Boundary::open) > 0; };
  if (std::none_of(multigrid.boundary.begin(), multigrid.boundary.end(), is_open)) return;
  for (std::size_t l = multigrid.base + 1; l < multigrid.levels.size(); ++l)
    for (Box const& box : multigrid.levels[l]->boxes())
      for (int d = 0; d < 3; ++d)
        for (int side = 0; side < 2; ++side)
          if (multigrid.boundary[d][side] == Boundary::open)
            refined_[d][side] |= multigrid.levels[l]->is_at_wall(box, d, side);
}

Real OpenWalls::first(std::size_t l, Index3 const& cell, int axis, int side) const {
  Real const own = multigrid_.levels[l]->spacing()[axis];
  Real const finest = refined_[axis][side] ? finest_spacing(l, multigrid_.levels[l]->wrapped(cell), axis, side)
                                           : std::min(own, multigrid_.levels[multigrid_.base]->spacing()[axis]);
  Real const wall = side == 0 ? 0.5 : multigrid_.upper[l][axis].wall;
  return ghost_that_vanishes(wall + 0.5 * finest / own);
}

Real OpenWalls::finest_spacing(std::size_t l, Index3 const& cell, int axis, int side) const {
  if (l + 1 == multigrid_.levels.size()) return multigrid_.levels[l]->spacing()[axis];
  Level const& finer = *multigrid_.levels[l + 1];
  Box children = Box{cell, cell}.refine(multigrid_.ratio[l + 1]);
  children.lower[axis] = children.upper[axis] = side == 0 ? finer.domain().lower[axis] : finer.domain().upper[axis];
  children = children.intersect(finer.domain());
  if (finer.find(children.lower) < 0) return multigrid_.levels[l]->spacing()[axis];
  Real sum = 0;
  for_each_cell(children, [&](Index3 const& child) { sum += finest_spacing(l + 1, child, axis, side); });
  return sum / Real(children.cells());
}

}  // namespace amrpic
