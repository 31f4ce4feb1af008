#include "mesh/metal.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <optional>

#include "mesh/box_set.hpp"

namespace amrpic {

namespace {

/// Whether what cuts an arm lies behind a wall.
bool is_behind_wall(CutCell const& cut, std::size_t n, Level const& level) {
  int const axis = int(n) / 2;
  bool const ends = cut.cell[axis] == (n % 2 == 0 ? level.domain().lower : level.domain().upper)[axis];
  return ends && !level.periodic()[axis] && cut.arm[n] >= wall_arm;
}

MetalCells without_metal_behind_walls(MetalCells const& cells, Level const& level) {
  auto const has_any = [&](CutCell const& cut) {
    for (std::size_t n = 0; n < 6; ++n)
      if (cut.is_cut(n) && is_behind_wall(cut, n, level)) return true;
    return false;
  };
  if (std::none_of(cells.cut().begin(), cells.cut().end(), has_any)) return cells;
  std::vector<CutCell> out;
  for (CutCell cut : cells.cut()) {
    for (std::size_t n = 0; n < 6; ++n)
      if (is_behind_wall(cut, n, level)) cut.electrode[n] = -1;
    if (cut.is_cut()) out.push_back(cut);
  }
  return cells.with(std::move(out));
}

/// What a box is within the domain, piece by piece; images behind periodic faces are those of its cells.
std::vector<Box> within_domain(Level const& level, Box const& box) {
  Box const& domain = level.domain();
  std::vector<Box> out{level.cut_at_walls(box)};
  for (int d = 0; d < 3; ++d) {
    if (!level.periodic()[d]) continue;
    std::vector<Box> pieces;
    for (Box piece : out) {
      if (piece.extent(d) >= domain.extent(d)) piece.lower[d] = domain.lower[d], piece.upper[d] = domain.upper[d];
      for (int by : {-1, 0, 1}) {
        Index3 shift{0, 0, 0};
        shift[d] = by * domain.extent(d);
        Box part = piece.shift(shift);
        part.lower[d] = std::max(part.lower[d], domain.lower[d]);
        part.upper[d] = std::min(part.upper[d], domain.upper[d]);
        if (!part.empty()) pieces.push_back(part);
      }
    }
    out = pieces;
  }
  return out;
}

std::vector<Box> without(std::vector<Box> boxes, std::vector<Box> const& holes) {
  for (Box const& hole : holes)
    if (std::any_of(boxes.begin(), boxes.end(), [&](Box const& box) { return !box.intersect(hole).empty(); }))
      boxes = amrpic::without(boxes, hole);
  return boxes;
}

/// Disjoint boxes with all cells of some; a single one, if the others are most of it.
std::vector<Box> disjoint(std::vector<Box> const& boxes) {
  Box all;
  for (Box const& box : boxes) all = all.empty() ? box : box.empty() ? all : all.hull(box);
  if (all.empty()) return {};
  GlobalIndex cells = 0;
  for (Box const& box : boxes) cells += box.cells();
  std::vector<Box> out;
  if (2 * cells < all.cells() || boxes.size() < 300)
    for (Box const& box : boxes) {
      auto const left = without({box}, out);
      out.insert(out.end(), left.begin(), left.end());
    }
  GlobalIndex covered = 0;
  for (Box const& box : out) covered += box.cells();
  return out.empty() || 2 * covered > all.cells() ? std::vector<Box>{all} : out;
}

}  // namespace

/// In boxes, which may overlap; sorted.
MetalCells const& Metal::found(std::vector<Box> const& boxes, Real3 const& spacing) const {
  for (Known const& known : known_) {
    auto const is_known = [&](Box const& box) { return known.boxes.cells_in(box) == box.cells(); };
    if (known.spacing == spacing && std::all_of(boxes.begin(), boxes.end(), is_known)) return known.cells;
  }
  std::vector<Box> const asked = disjoint(boxes);
  auto [cut, solid] = ask_(asked, spacing);
  if (asked.size() > 1) {
    std::sort(cut.begin(), cut.end(), [](auto const& a, auto const& b) { return comes_before(a.cell, b.cell); });
    std::sort(solid.begin(), solid.end(), [](auto const& a, auto const& b) { return comes_before(a.first, b.first); });
  }
  known_.push_back({spacing, BoxTable(asked), {std::move(cut), std::move(solid)}});
  return known_.back().cells;
}

/// Cells, and those whose arms miss metal that arms of finer levels meet there. Corrections that did not know of it,
/// such as of a grid of wires, would overshoot without bound. Its hold is that of a potential that is constant in each
/// coarse cell: the mean over the finest cells of what metal adds to their diagonals, each arm that it cuts as if it
/// ended at a centre.
MetalCells Metal::with_thin(Level const& level, std::vector<Box> const& regions, std::vector<Level const*> const& finer,
                            MetalCells const& cells) const {
  std::vector<Hold> holds;
  for (std::size_t n = 0; n < finer.size(); ++n)
    add_holds(level, *finer[n], n + 1 < finer.size() ? finer[n + 1] : nullptr, regions, cells, holds);
  if (holds.empty()) return cells;
  std::stable_sort(holds.begin(), holds.end(),
                   [](Hold const& a, Hold const& b) { return comes_before(a.cell, b.cell); });
  std::vector<CutCell> held, out;
  for (Hold const& hold : holds) {
    if (held.empty() || held.back().cell != hold.cell) held.push_back(CutCell::uncut(hold.cell));
    held.back().hold += hold.share;
  }
  out.reserve(cells.cut().size() + held.size());
  std::merge(cells.cut().begin(), cells.cut().end(), held.begin(), held.end(), std::back_inserter(out),
             [](CutCell const& a, CutCell const& b) { return comes_before(a.cell, b.cell); });
  return cells.with(std::move(out));
}

/// Those of the cells of a finer level that `next` does not cover, by cells that are neither cut nor in metal.
void Metal::add_holds(Level const& level, Level const& finer, Level const* next, std::vector<Box> const& regions,
                      MetalCells const& cells, std::vector<Hold>& to) const {
  Index3 ratio;
  Real coarse = 0, children = 1;
  Real3 weight;
  for (int d = 0; d < 3; ++d) {
    ratio[d] = std::max(1, int(std::lround(level.spacing()[d] / finer.spacing()[d])));
    weight[d] = 1 / (finer.spacing()[d] * finer.spacing()[d]);
    coarse += 2 / (level.spacing()[d] * level.spacing()[d]);
    children *= ratio[d];
  }
  std::vector<Box> parts;
  for (Box const& region : regions)
    finer.for_each_overlap(region.refine(ratio).intersect(finer.domain()),
                           [&](int, Box const& part, Index3 const&) { parts.push_back(part); });
  if (children == 1 || parts.empty()) return;
  MetalCells const& metal = found(parts, finer.spacing());
  auto const counts = [&](Index3 const& child) {
    return finer.find(child) >= 0 && !(next && next->find(first_child_of(child)) >= 0);
  };
  std::optional<Index3> latest;  // many children of a cell follow each other
  bool may_hold = false;
  auto const is_plain = [&](Index3 const& cell) {
    if (latest != cell) latest = cell, may_hold = level.domain().contains(cell) && !cells.cut_at(cell);
    return may_hold;
  };
  auto const parent = [&](Index3 const& child) {
    return Index3{child[0] / ratio[0], child[1] / ratio[1], child[2] / ratio[2]};
  };
  Real const whole = children * coarse;
  for (CutCell const& cut : metal.cut()) {
    Index3 const cell = parent(cut.cell);
    if (!is_plain(cell) || cells.solid_at(cell) || !counts(cut.cell)) continue;
    for (std::size_t n = 0; n < 6; ++n)
      if (cut.is_cut(n) && !is_behind_wall(cut, n, finer)) to.push_back({cell, weight[int(n) / 2] / whole});
  }
  Real const of_solid = 2 * (weight[0] + weight[1] + weight[2]) / whole;
  for (SolidCells const& run : metal.solid())
    for (Index3 child = run.first; child[0] < run.first[0] + run.count; ++child[0]) {
      Index3 const cell = parent(child);
      if (SolidCells const* const own = cells.solid_at(cell))  // on to what lies behind these
        child[0] = ratio[0] * (own->first[0] + own->count) - 1;
      else if (is_plain(cell) && counts(child))
        to.push_back({cell, of_solid});
    }
}

MetalCells Metal::cells(Level const& level, std::vector<Box> const& boxes,
                        std::vector<Level const*> const& finer) const {
  std::vector<Box> regions;
  for (Box const& box : boxes)
    for (Box const& piece : within_domain(level, box))
      if (!piece.empty()) regions.push_back(piece);
  if (regions.empty()) return {};
  MetalCells const cells = without_metal_behind_walls(found(regions, level.spacing()), level);
  return finer.empty() ? cells : with_thin(level, regions, finer, cells);
}

MetalCells Metal::own_cells(Level const& level) const {
  std::vector<Box> boxes;
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b) boxes.push_back(level.box(b).grow(reach));
  return cells(level, boxes);
}

}  // namespace amrpic
