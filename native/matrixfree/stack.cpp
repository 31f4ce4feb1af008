#include "matrixfree/stack.hpp"

#include <algorithm>

namespace amrpic::matrixfree {

namespace {

constexpr GlobalIndex small = 10000;  ///< cells of a level that every rank relaxes faster than it hears of others
constexpr GlobalIndex bottom = 64;    ///< cells of a level that is solved faster than coarsened

/// By how much to coarsen each axis of a level; all ones if it must stay.
Index3 coarsening_of(Level const& level) {
  if (level.cells() <= bottom) return {1, 1, 1};
  auto divisible = [&](int d) { return level.domain().extent(d) % 2 == 0 && level.domain().extent(d) > 2; };
  // red-black order needs an even number of cells around a periodic axis
  for (int d = 0; d < 3; ++d)
    if (level.periodic()[d] && level.domain().extent(d) % 2 != 0) return {1, 1, 1};
  Real const finest = *std::min_element(level.spacing().begin(), level.spacing().end());
  Index3 ratio{1, 1, 1};
  for (int d = 0; d < 3; ++d) {
    // a point smoother reduces just those errors that oscillate along the strongly coupled axes
    if (level.spacing()[d] > 1.5 * finest) continue;
    if (!divisible(d)) return {1, 1, 1};
    ratio[d] = 2;
  }
  return ratio;
}

/// The largest power of two, at most 8, that divides all extents.
int common_power(Box const& box) {
  int power = 8;
  for (int d = 0; d < 3; ++d)
    while (box.extent(d) % power != 0) power /= 2;
  return power;
}

std::shared_ptr<Level const> coarsened(Level const& level, Index3 const& ratio, Level const& base) {
  Real3 spacing = level.spacing();
  for (int d = 0; d < 3; ++d) spacing[d] *= ratio[d];
  Box const domain = level.domain().coarsen(ratio);
  if (domain.cells() <= small || level.ranks() == 1)
    return std::make_shared<Level const>(domain, level.periodic(), spacing, std::vector<Box>{domain},
                                         std::vector<int>{0, 1}, 0);
  std::vector<Box> boxes = level.boxes();
  std::vector<int> first;
  bool const even = std::all_of(boxes.begin(), boxes.end(), [&](Box const& b) {
    Box const parents = b.coarsen(ratio);
    return parents.refine(ratio) == b;
  });
  if (even) {
    for (Box& b : boxes) b = b.coarsen(ratio);
    for (int r = 0; r <= level.ranks(); ++r) first.push_back(level.first_box(r));
  } else {
    int most = 0;
    for (Box const& b : base.boxes())
      for (int d = 0; d < 3; ++d) most = std::max(most, b.extent(d));
    boxes = cut(domain, most, common_power(domain));
    sort_along_curve(boxes);
    std::vector<Real> load(boxes.size());
    std::transform(boxes.begin(), boxes.end(), load.begin(), [](Box const& b) { return Real(b.cells()); });
    first = distribute(load, level.ranks());
  }
  return std::make_shared<Level const>(domain, level.periodic(), spacing, boxes, first, level.rank());
}

}  // namespace

LevelStack coarsen_in_place(LevelStack stack, Domain const& domain) {
  Level const& base = *stack.levels[stack.base];
  auto put_below = [&](Index3 const& ratio) {
    auto const level = coarsened(*stack.levels.front(), ratio, base);
    WallGhosts walls = wall_ghosts(domain, [](Boundary kind, int) { return coarse_wall_ghost(kind); });
    // Along an axis that keeps its cells, errors which oscillate meet the finer level's wall on every level below.
    for (int d = 0; d < 3; ++d)
      if (ratio[d] == 1) walls[d] = stack.walls.front()[d];
    stack.ratio.front() = ratio;
    stack.ratio.insert(stack.ratio.begin(), Index3{1, 1, 1});
    stack.levels.insert(stack.levels.begin(), level);
    stack.walls.insert(stack.walls.begin(), walls);
    ++stack.base;
  };
  for (Index3 ratio; (ratio = coarsening_of(*stack.levels.front())) != Index3{1, 1, 1};) put_below(ratio);
  return stack;
}

}  // namespace amrpic::matrixfree
