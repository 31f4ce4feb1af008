#include "multigrid/multigrid_levels.hpp"

#include <algorithm>
#include <limits>

#include "mesh/box_set.hpp"
#include "multigrid/open_walls.hpp"
#include "stencil/cycle_ghost.hpp"

namespace amrpic {

namespace {

constexpr GlobalIndex bottom = 64;           ///< cells of a level that is solved faster than coarsened
constexpr GlobalIndex cells_per_rank = 512;  ///< of a level: with fewer, boxes are thinner than their halos twice over
constexpr int merged_ranks = 8;              ///< so many then bring theirs together: all children of a cube of boxes
constexpr int alignment = 8;                 ///< of new boxes, so that they can be halved three times
constexpr int before_whole = 8;              ///< ranks, each with an eighth of a level: they are all neighbours

/// By how much to coarsen each axis of a level; all ones if it must stay.
Index3 coarsening_of(Level const& level, Domain const& domain) {
  auto shortens = [&](int d) { return can_be_coarsened(level.domain().extent(d), domain.boundary[d]); };
  Real finest = std::numeric_limits<Real>::infinity();
  for (int d = 0; d < 3; ++d)
    if (shortens(d)) finest = std::min(finest, level.spacing()[d]);
  Index3 ratio{1, 1, 1};
  if (level.cells() <= bottom) return ratio;
  // a point smoother reduces just those errors that oscillate along the strongly coupled axes
  for (int d = 0; d < 3; ++d)
    if (shortens(d) && level.spacing()[d] <= 1.5 * finest) ratio[d] = 2;
  return ratio;
}

/// Where runs of boxes start on so many ranks if they lie on evenly spread ones of them: neighbours on the curve stay
/// near, and the others' memory and network serve too.
std::vector<int> spread(std::vector<int> const& first, int ranks) {
  std::vector<int> out;
  std::int64_t const active = std::int64_t(first.size()) - 1;
  std::int64_t run = 0;
  for (int r = 0; r <= ranks; ++r) {
    while (run < active && run * ranks / active < r) ++run;
    out.push_back(first[std::size_t(run)]);
  }
  return out;
}

/// New boxes for a level that covers the domain, on `active` of the ranks.
DistributedBoxes new_boxes(Box const& domain, int max_grid_size, int ranks, int active) {
  DistributedBoxes out{cut(domain, std::max(max_grid_size, alignment), alignment), {}};
  out.first = spread(share_out(out.boxes, active, alignment), ranks);
  return out;
}

/// A level that covers the domain in eight boxes, on as many ranks.
DistributedBoxes eighths(Box const& domain, int ranks) {
  int longest = 0;
  for (int d = 0; d < 3; ++d) longest = std::max(longest, domain.extent(d));
  DistributedBoxes out{cut(domain, (longest + 3) / 4 * 2, 2), {}};
  out.first = spread(share_out(out.boxes, before_whole, 2), ranks);
  return out;
}

/// The boxes of so many ranks in use after each other brought together on the first of them, and joined to larger ones.
DistributedBoxes merged(DistributedBoxes const& given, int group) {
  DistributedBoxes out;
  int const ranks = int(given.first.size()) - 1;
  for (int r = 0, used = 0; r < ranks; ++r) {
    out.first.push_back(int(out.boxes.size()));
    if (given.first[r] == given.first[r + 1] || used++ % group != 0) continue;
    int last = r;
    for (int found = 0; last < ranks; ++last)
      if (given.first[last] != given.first[last + 1] && ++found > group) break;
    auto const large = joined({given.boxes.begin() + given.first[r], given.boxes.begin() + given.first[last]});
    out.boxes.insert(out.boxes.end(), large.begin(), large.end());
  }
  out.first.push_back(int(out.boxes.size()));
  return out;
}

std::shared_ptr<Level const> coarser(Level const& finer, Index3 const& ratio, Box const& domain,
                                     CoarseBoxes const& policy) {
  std::array<bool, 3> periodic;
  for (int d = 0; d < 3; ++d) periodic[d] = finer.periodic()[d] && (ratio[d] == 1 || domain.extent(d) > 1);
  Real3 spacing = finer.spacing();
  for (int d = 0; d < 3; ++d) spacing[d] *= ratio[d];
  if (domain.cells() <= policy.whole || (policy.whole > 0 && finer.ranks() == 1))
    return std::make_shared<Level const>(domain, periodic, spacing, std::vector<Box>{domain}, std::vector<int>{0, 1},
                                         0);
  int const in_use = finer.ranks_in_use();
  int group = 1;
  while (group < in_use && domain.cells() * group < cells_per_rank * in_use) group *= merged_ranks;
  DistributedBoxes distributed = halved(finer, ratio, domain);
  if (in_use > before_whole && group > 1 && domain.cells() <= before_whole * policy.whole)
    distributed = eighths(domain, finer.ranks());
  else if (distributed.boxes.empty())
    distributed = new_boxes(domain, policy.max_grid_size, finer.ranks(), (in_use + group - 1) / group);
  else if (group > 1)
    distributed = merged(distributed, group);
  return std::make_shared<Level const>(domain, periodic, spacing, std::move(distributed.boxes),
                                       std::move(distributed.first), finer.rank());
}

/// How far behind upper open walls corrections vanish at the least: half a cell of the finest level there.
Real3 behind_open_walls(MultigridLevels const& multigrid) {
  Real3 out{0, 0, 0};
  for (auto const& level : multigrid.levels)
    for (int d = 0; d < 3; ++d) {
      bool const touches = std::any_of(level->boxes().begin(), level->boxes().end(),
                                       [&](Box const& box) { return level->is_at_wall(box, d, 1); });
      if (touches && multigrid.boundary[d][1] == Boundary::open) out[d] = 0.5 * level->spacing()[d];
    }
  return out;
}

/// See MultigridLevels::parents_in_place.
bool keeps_parents_in_place(Level const& level, Level const& coarser, Index3 const& ratio) {
  if (coarser.ranks() != level.ranks() || coarser.box_count() != level.box_count()) return false;
  for (int r = 0; r <= level.ranks(); ++r)
    if (coarser.first_box(r) != level.first_box(r)) return false;
  for (int b = 0; b < level.box_count(); ++b) {
    Box const& box = level.box(b);
    if (!(box.coarsen(ratio).intersect(coarser.domain()) == coarser.box(b))) return false;
    for (int d = 0; d < 3; ++d)
      if (box.lower[d] % ratio[d] != 0) return false;
  }
  return true;
}

/// Put a level below the lowest one.
void put_below(MultigridLevels& multigrid, Domain const& domain, Index3 const& ratio, Real3 const& behind,
               CoarseBoxes const& policy) {
  Level const& finer = *multigrid.levels.front();
  Box region = finer.domain();
  std::array<UpperEnd, 3> upper = multigrid.upper.front();
  WallGhosts walls = multigrid.walls.front();
  for (int d = 0; d < 3; ++d) {
    // Along an axis that keeps its cells, errors which oscillate meet the finer level's wall on every level below.
    if (ratio[d] == 1) continue;
    CoarseAxis const axis =
        coarsened(region.extent(d), upper[d], domain.boundary[d][1], behind[d] / finer.spacing()[d]);
    region.upper[d] = axis.cells - 1;
    upper[d] = axis.end;
    walls[d] = {coarse_wall_ghost(domain.boundary[d][0], axis.cells, {}),
                coarse_wall_ghost(domain.boundary[d][1], axis.cells, axis.end)};
  }
  auto const level = coarser(finer, ratio, region, policy);
  multigrid.ratio.front() = ratio;
  multigrid.parents_in_place.front() = keeps_parents_in_place(finer, *level, ratio);
  multigrid.parents_in_place.insert(multigrid.parents_in_place.begin(), 0);
  multigrid.ratio.insert(multigrid.ratio.begin(), Index3{1, 1, 1});
  multigrid.levels.insert(multigrid.levels.begin(), level);
  multigrid.faces.insert(multigrid.faces.begin(), nullptr);
  multigrid.walls.insert(multigrid.walls.begin(), walls);
  multigrid.upper.insert(multigrid.upper.begin(), upper);
  ++multigrid.base;
}

}  // namespace

MultigridLevels refinement_levels(Hierarchy const& hierarchy, Real shift, int order) {
  MultigridLevels multigrid;
  multigrid.shift = shift;
  multigrid.boundary = hierarchy.domain().boundary;
  for (int l = 0; l < hierarchy.level_count(); ++l) {
    multigrid.levels.push_back(hierarchy.share_level(l));
    multigrid.faces.push_back(hierarchy.share_faces(l));
    multigrid.ratio.push_back(refinement_ratio);
    multigrid.parents_in_place.push_back(0);
    multigrid.upper.emplace_back();
    Real3 const h = hierarchy.level(l).spacing();
    WallGhosts& walls = multigrid.walls.emplace_back();
    for (int d = 0; d < 3; ++d)
      for (int side = 0; side < 2; ++side) walls[d][side] = cycle_ghost(multigrid.boundary[d][side], h[d], order);
  }
  return multigrid;
}

DistributedBoxes halved(Level const& finer, Index3 const& ratio, Box const& domain) {
  DistributedBoxes out;
  for (Box const& fine : finer.boxes()) {
    Box const box = fine.coarsen(ratio).intersect(domain);
    if (box.empty()) return {};
    for (int d = 0; d < 3; ++d) {
      bool const ends_domain = fine.upper[d] == finer.domain().upper[d];
      if (fine.lower[d] % ratio[d] != 0 || (fine.extent(d) % ratio[d] != 0 && !ends_domain)) return {};
      if (ratio[d] == 2 && box.lower[d] % 2 != 0) return {};
    }
    out.boxes.push_back(box);
  }
  for (int r = 0; r <= finer.ranks(); ++r) out.first.push_back(finer.first_box(r));
  return out;
}

std::vector<int> distribute_along_curve(std::vector<Box>& boxes, int ranks) {
  sort_along_curve(boxes);
  return distribute(boxes, ranks);
}

MultigridLevels coarsen_below(MultigridLevels multigrid, Domain const& domain, CoarseBoxes const& boxes, int most) {
  Real3 const behind = behind_open_walls(multigrid);
  while (int(multigrid.base) < most) {
    Index3 const ratio = coarsening_of(*multigrid.levels.front(), domain);
    if (ratio == Index3{1, 1, 1}) break;
    put_below(multigrid, domain, ratio, behind, boxes);
  }
  return multigrid;
}

MultigridLevels seen_by(MultigridLevels multigrid, Hierarchy const& hierarchy) {
  for (std::size_t l = 0; l < multigrid.levels.size(); ++l) {
    auto& level = multigrid.levels[l];
    if (l >= multigrid.base) {
      level = hierarchy.share_level(int(l - multigrid.base));
      multigrid.faces[l] = hierarchy.share_faces(int(l - multigrid.base));
    } else if (level->ranks() > 1) {
      level = level->seen_by(hierarchy.comm().rank());
    }
  }
  return multigrid;
}

Real prolonged_end(MultigridLevels const& multigrid, OpenWalls const& open_walls, std::size_t l, Index3 const& cell,
                   int axis, int side) {
  Boundary const kind = multigrid.boundary[axis][side];
  if (kind == Boundary::open) return open_walls.first(l, cell, axis, side);
  return prolonged_wall_ghost(kind, side == 0 ? UpperEnd{} : multigrid.upper[l][axis]);
}

std::array<LastChildren, 3> last_children_of(MultigridLevels const& multigrid, std::size_t finer) {
  std::array<LastChildren, 3> out;
  for (int d = 0; d < 3; ++d)
    if (multigrid.ratio[finer][d] == 2)
      out[d] = last_children(multigrid.levels[finer]->domain().extent(d), multigrid.upper[finer][d],
                             multigrid.boundary[d][1]);
  return out;
}

}  // namespace amrpic
