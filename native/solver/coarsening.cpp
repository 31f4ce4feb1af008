#include "solver/coarsening.hpp"

#include <algorithm>

namespace amrpic {

namespace {

/// By how much to coarsen each axis of a level; all ones if it must stay.
Index3 coarsening_of(Level const& level) {
  Real const finest = *std::min_element(level.spacing().begin(), level.spacing().end());
  Index3 ratio{1, 1, 1};
  for (int d = 0; d < 3; ++d) {
    int const n = level.domain().extent(d);
    // red-black order needs an even number of cells around a periodic axis
    if (level.periodic()[d] && n % 2 != 0) return {1, 1, 1};
    if (level.spacing()[d] > 1.5 * finest) continue;
    if (n % 2 != 0 || n <= 2) return {1, 1, 1};
    ratio[d] = 2;
  }
  return ratio;
}

std::shared_ptr<Level const> coarsened(Level const& level, Index3 const& ratio, int max_grid_size) {
  Real3 spacing = level.spacing();
  for (int d = 0; d < 3; ++d) spacing[d] *= ratio[d];
  Box const domain = level.domain().coarsen(ratio);
  auto boxes = cut(domain, max_grid_size, 1);
  sort_along_curve(boxes);
  std::vector<Real> load(boxes.size());
  std::transform(boxes.begin(), boxes.end(), load.begin(), [](Box const& b) { return Real(b.cells()); });
  return std::make_shared<Level const>(domain, level.periodic(), spacing, boxes, distribute(load, level.ranks()),
                                       level.rank());
}

}  // namespace

LevelStack coarsen_below(LevelStack stack, Domain const& domain, int max_grid_size, int most) {
  while (int(stack.base) < most) {
    Index3 const ratio = coarsening_of(*stack.levels.front());
    if (ratio == Index3{1, 1, 1}) break;
    auto const level = coarsened(*stack.levels.front(), ratio, max_grid_size);
    stack.ratio.front() = ratio;
    stack.ratio.insert(stack.ratio.begin(), Index3{1, 1, 1});
    stack.levels.insert(stack.levels.begin(), level);
    WallGhosts walls = wall_ghosts(domain, [](Boundary kind, int) { return coarse_wall_ghost(kind); });
    // Along an axis that keeps its cells, errors which oscillate meet the finer level's wall on every level below.
    for (int d = 0; d < 3; ++d)
      if (ratio[d] == 1) walls[d] = stack.walls.front()[d];
    stack.walls.insert(stack.walls.begin(), walls);
    ++stack.base;
  }
  return stack;
}

}  // namespace amrpic
