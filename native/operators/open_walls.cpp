#include "operators/open_walls.hpp"

namespace amrpic {

OpenWalls::OpenWalls(LevelStack const& stack) : stack_(stack) {
  for (std::size_t l = stack.base + 1; l < stack.levels.size(); ++l)
    for (Box const& box : stack.levels[l]->boxes())
      for (int d = 0; d < 3; ++d) {
        refined_[d][0] |= box.lower[d] == stack.levels[l]->domain().lower[d];
        refined_[d][1] |= box.upper[d] == stack.levels[l]->domain().upper[d];
      }
}

bool refines_open_wall(LevelStack const& stack) {
  for (std::size_t l = stack.base + 1; l < stack.levels.size(); ++l)
    for (Box const& box : stack.levels[l]->boxes())
      for (int d = 0; d < 3; ++d) {
        Box const& domain = stack.levels[l]->domain();
        if (stack.boundary[d][0] == Boundary::open && box.lower[d] == domain.lower[d]) return true;
        if (stack.boundary[d][1] == Boundary::open && box.upper[d] == domain.upper[d]) return true;
      }
  return false;
}

Real OpenWalls::first(std::size_t l, Index3 const& cell, int axis, int side) const {
  Real const own = stack_.levels[l]->spacing()[axis];
  Real const finest = refined_[axis][side] ? finest_spacing(l, cell, axis, side)
                                           : std::min(own, stack_.levels[stack_.base]->spacing()[axis]);
  Real const wall = side == 0 ? 0.5 : stack_.upper[l][axis].wall;
  return ghost_that_vanishes(wall + 0.5 * finest / own);
}

Real OpenWalls::finest_spacing(std::size_t l, Index3 const& cell, int axis, int side) const {
  if (l + 1 == stack_.levels.size()) return stack_.levels[l]->spacing()[axis];
  Level const& finer = *stack_.levels[l + 1];
  Box children = Box{cell, cell}.refine(stack_.ratio[l + 1]);
  children.lower[axis] = children.upper[axis] = side == 0 ? finer.domain().lower[axis] : finer.domain().upper[axis];
  children = children.intersect(finer.domain());
  if (finer.find(children.lower) < 0) return stack_.levels[l]->spacing()[axis];
  Real sum = 0;
  for_each_cell(children, [&](Index3 const& child) { sum += finest_spacing(l + 1, child, axis, side); });
  return sum / Real(children.cells());
}

}  // namespace amrpic
