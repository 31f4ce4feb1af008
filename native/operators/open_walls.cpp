#include "operators/open_walls.hpp"

namespace amrpic {

OpenWalls::OpenWalls(MultigridLevels const& multigrid) : multigrid_(multigrid) {
  for (std::size_t l = multigrid.base + 1; l < multigrid.levels.size(); ++l)
    for (Box const& box : multigrid.levels[l]->boxes())
      for (int d = 0; d < 3; ++d) {
        refined_[d][0] |= box.lower[d] == multigrid.levels[l]->domain().lower[d];
        refined_[d][1] |= box.upper[d] == multigrid.levels[l]->domain().upper[d];
      }
}

bool refines_open_wall(MultigridLevels const& multigrid) {
  for (std::size_t l = multigrid.base + 1; l < multigrid.levels.size(); ++l)
    for (Box const& box : multigrid.levels[l]->boxes())
      for (int d = 0; d < 3; ++d) {
        Box const& domain = multigrid.levels[l]->domain();
        if (multigrid.boundary[d][0] == Boundary::open && box.lower[d] == domain.lower[d]) return true;
        if (multigrid.boundary[d][1] == Boundary::open && box.upper[d] == domain.upper[d]) return true;
      }
  return false;
}

Real OpenWalls::first(std::size_t l, Index3 const& cell, int axis, int side) const {
  Real const own = multigrid_.levels[l]->spacing()[axis];
  Real const finest = refined_[axis][side] ? finest_spacing(l, cell, axis, side)
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
