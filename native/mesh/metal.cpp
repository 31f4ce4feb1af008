#include "mesh/metal.hpp"

#include <algorithm>
#include <cmath>

#include "mesh/box_set.hpp"

namespace amrpic {

namespace {

/// Whether what cuts an arm lies behind a wall.
bool is_behind_wall(CutCell const& cut, std::size_t n, Level const& level) {
  int const axis = int(n) / 2;
  bool const ends = cut.cell[axis] == (n % 2 == 0 ? level.domain().lower : level.domain().upper)[axis];
  return ends && !level.periodic()[axis] && cut.arm[n] >= wall_arm;
}

std::vector<CutCell> without_metal_behind_walls(std::vector<CutCell> cells, Level const& level) {
  for (CutCell& cut : cells)
    for (std::size_t n = 0; n < 6; ++n)
      if (is_behind_wall(cut, n, level)) cut.electrode[n] = -1;
  auto const is_whole = [](CutCell const& cut) { return !cut.is_cut(); };
  cells.erase(std::remove_if(cells.begin(), cells.end(), is_whole), cells.end());
  return cells;
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
  for (Box const& hole : holes) boxes = amrpic::without(boxes, hole);
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

/// Sorted.
MetalCells const& Metal::found(std::vector<Box> const& boxes, Real3 const& spacing) const {
  for (Known const& known : known_) {
    if (known.spacing != spacing) continue;
    auto const is_known = [&](Box const& box) { return without({box}, known.boxes).empty(); };
    if (std::all_of(boxes.begin(), boxes.end(), is_known)) return known.cells;
  }
  auto [cut, solid] = ask_(boxes, spacing);
  auto const sort = [&](auto& cells) {
    auto const before = [](auto const& a, auto const& b) { return comes_before(a.cell, b.cell); };
    if (boxes.size() > 1) std::sort(cells.begin(), cells.end(), before);
  };
  sort(cut), sort(solid);
  known_.push_back({spacing, boxes, {std::move(cut), std::move(solid)}});
  return known_.back().cells;
}

/// Add the cells whose arms miss metal that arms of finer levels meet there. Corrections that did not know of it, such
/// as of a grid of wires, would overshoot without bound. Its hold is that of a potential that is constant in each
/// coarse cell: the mean over the finest cells of what metal adds to their diagonals, each arm that it cuts as if it
/// ended at a centre.
void Metal::add_thin(Level const& level, std::vector<Box> const& regions, std::vector<Level const*> const& finer,
                     MetalCells& cells) const {
  std::vector<CutCell> out = cells.cut();
  for (Box const& region : regions) {
    constexpr Real in_metal = -1;
    std::vector<Real> hold(std::size_t(region.cells()), 0.0);
    for (SolidCell const& solid : cells.solid())
      if (region.contains(solid.cell)) hold[std::size_t(region.offset(solid.cell))] = in_metal;
    for (std::size_t n = 0; n < finer.size(); ++n)
      add_holds(level, *finer[n], n + 1 < finer.size() ? finer[n + 1] : nullptr, region, hold);
    for (std::size_t n = 0; n < cells.cut().size(); ++n) {
      if (!region.contains(out[n].cell)) continue;
      Real& h = hold[std::size_t(region.offset(out[n].cell))];
      if (!out[n].is_cut()) out[n].hold = h;
      h = 0;
    }
    for_each_cell(region, [&](Index3 const& cell) {
      if (Real const h = hold[std::size_t(region.offset(cell))]; h > 0) out.push_back(CutCell::uncut(cell, h));
    });
  }
  std::sort(out.begin(), out.end(), [](auto const& a, auto const& b) { return comes_before(a.cell, b.cell); });
  cells = {std::move(out), cells.solid()};
}

/// Those of the cells of a finer level that `next` does not cover, to cells of which it is not negative: the others are
/// in metal.
void Metal::add_holds(Level const& level, Level const& finer, Level const* next, Box const& region,
                      std::vector<Real>& hold) const {
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
  finer.for_each_overlap(region.refine(ratio).intersect(finer.domain()),
                         [&](int, Box const& part, Index3 const&) { parts.push_back(part); });
  parts = disjoint(parts);
  if (children == 1 || parts.empty()) return;
  MetalCells const& metal = found(parts, finer.spacing());
  auto const add = [&](Index3 const& child, Real share) {
    Index3 const cell{child[0] / ratio[0], child[1] / ratio[1], child[2] / ratio[2]};
    if (!region.contains(cell)) return;
    Real& of_cell = hold[std::size_t(region.offset(cell))];
    if (of_cell < 0 || finer.find(child) < 0 || (next && next->find(first_child_of(child)) >= 0)) return;
    of_cell += share / (children * coarse);
  };
  for (CutCell const& cut : metal.cut())
    for (std::size_t n = 0; n < 6; ++n)
      if (cut.is_cut(n) && !is_behind_wall(cut, n, finer)) add(cut.cell, weight[int(n) / 2]);
  for (SolidCell const& solid : metal.solid()) add(solid.cell, 2 * (weight[0] + weight[1] + weight[2]));
}

MetalCells Metal::cells(Level const& level, std::vector<Box> const& boxes,
                        std::vector<Level const*> const& finer) const {
  std::vector<Box> regions;
  for (Box const& box : boxes)
    for (Box const& piece : within_domain(level, box)) regions.push_back(piece);
  regions = disjoint(regions);
  if (regions.empty()) return {};
  MetalCells const& all = found(regions, level.spacing());
  MetalCells out{without_metal_behind_walls(all.cut(), level), all.solid()};
  if (!finer.empty()) add_thin(level, regions, finer, out);
  return out;
}

MetalCells Metal::own_cells(Level const& level) const {
  std::vector<Box> boxes;
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b) boxes.push_back(level.box(b).grow(reach));
  return cells(level, boxes);
}

}  // namespace amrpic
