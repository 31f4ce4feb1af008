#include "mesh/metal.hpp"

#include <algorithm>
#include <cmath>

namespace amrpic {

namespace {

std::vector<CutCell> without_metal_behind_walls(std::vector<CutCell> cells, Box const& domain,
                                                std::array<bool, 3> const& periodic) {
  for (CutCell& cut : cells)
    for (std::size_t n = 0; n < 6; ++n) {
      int const axis = int(n) / 2;
      bool const ends = cut.cell[axis] == (n % 2 == 0 ? domain.lower : domain.upper)[axis];
      if (ends && !periodic[axis] && cut.arm[n] >= wall_arm) cut.electrode[n] = -1;
    }
  return cells;
}

bool comes_before(Index3 const& a, Index3 const& b) {
  return std::array{a[2], a[1], a[0]} < std::array{b[2], b[1], b[0]};
}

}  // namespace

/// On a level coarser than the base: add the cells whose arms miss metal that arms of the base meet there. Corrections
/// that did not know of it, such as of a grid of wires, would overshoot without bound. Its hold is that of a potential
/// that is constant in each coarse cell: the mean over the cells of the base of what metal adds to their diagonals,
/// each arm that it cuts as if it ended at a centre.
void Metal::add_thin(Level const& level, Box const& region, MetalCells& cells) const {
  Index3 ratio;
  Real3 spacing, weight;
  Real coarse = 0, children = 1;
  for (int d = 0; d < 3; ++d) {
    ratio[d] = std::max(1, int(std::lround(level.spacing()[d] / spacing_[d])));
    spacing[d] = level.spacing()[d] / ratio[d];
    weight[d] = 1 / (spacing[d] * spacing[d]);
    coarse += 2 / (level.spacing()[d] * level.spacing()[d]);
    children *= ratio[d];
  }
  if (children == 1) return;
  Box fine;
  for (int d = 0; d < 3; ++d)
    fine.lower[d] = region.lower[d] * ratio[d],
    fine.upper[d] = std::min((region.upper[d] + 1) * ratio[d] - 1, base_.upper[d]);
  MetalCells const of_base = ask_(fine, spacing);
  std::vector<Real> hold(std::size_t(region.cells()), 0.0);
  auto const at = [&](Index3 const& child) -> Real& {
    return hold[std::size_t(region.offset({child[0] / ratio[0], child[1] / ratio[1], child[2] / ratio[2]}))];
  };
  for (CutCell const& cut : without_metal_behind_walls(of_base.cut(), base_, level.periodic()))
    for (std::size_t n = 0; n < 6; ++n)
      if (cut.is_cut(n)) at(cut.cell) += weight[int(n) / 2] / (children * coarse);
  for (SolidCell const& solid : of_base.solid())
    at(solid.cell) += 2 * (weight[0] + weight[1] + weight[2]) / (children * coarse);
  for (SolidCell const& solid : cells.solid()) hold[std::size_t(region.offset(solid.cell))] = 0;
  std::vector<CutCell> out = cells.cut();
  for (CutCell& cut : out) {
    Real& h = hold[std::size_t(region.offset(cut.cell))];
    if (std::all_of(cut.electrode.begin(), cut.electrode.end(), [](int e) { return e < 0; })) cut.hold = h;
    h = 0;
  }
  std::size_t const cut = out.size();
  for_each_cell(region, [&](Index3 const& cell) {
    if (Real const h = hold[std::size_t(region.offset(cell))]; h > 0)
      out.push_back({cell, {2, 2, 2, 2, 2, 2}, {-1, -1, -1, -1, -1, -1}, h});
  });
  auto const before = [](CutCell const& a, CutCell const& b) { return comes_before(a.cell, b.cell); };
  std::inplace_merge(out.begin(), out.begin() + std::ptrdiff_t(cut), out.end(), before);
  cells = {std::move(out), cells.solid()};
}

MetalCells Metal::cells(Level const& level, std::vector<Box> const& boxes) const {
  Box region;
  Box const& domain = level.domain();
  for (Box box : boxes) {
    for (int d = 0; d < 3; ++d) {
      bool const is_image = box.lower[d] < domain.lower[d] || box.upper[d] > domain.upper[d];
      if (is_image && level.periodic()[d]) box.lower[d] = domain.lower[d], box.upper[d] = domain.upper[d];
    }
    region = region.empty() ? box : region.hull(box);
  }
  region = region.intersect(domain);
  if (region.empty()) return {};
  MetalCells const all = ask_(region, level.spacing());
  MetalCells out{without_metal_behind_walls(all.cut(), domain, level.periodic()), all.solid()};
  add_thin(level, region, out);
  return out;
}

MetalCells Metal::own_cells(Level const& level) const {
  return cells(level,
               {level.boxes().begin() + level.first_local_box(), level.boxes().begin() + level.last_local_box()});
}

}  // namespace amrpic
