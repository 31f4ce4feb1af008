#include "mesh/metal.hpp"

#include <algorithm>

namespace amrpic {

namespace {

void hide_metal_behind_walls(Level const& level, std::vector<CutCell>& cells) {
  for (CutCell& cut : cells)
    for (std::size_t n = 0; n < 6; ++n) {
      int const axis = int(n) / 2;
      bool const ends = cut.cell[axis] == (n % 2 == 0 ? level.domain().lower : level.domain().upper)[axis];
      if (ends && !level.periodic()[axis] && cut.arm[n] >= wall_arm) cut.electrode[n] = -1;
    }
}

}  // namespace

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
  MetalCells cells = ask_(region, level.spacing());
  std::vector<CutCell> cut = cells.cut();
  hide_metal_behind_walls(level, cut);
  return {std::move(cut), cells.solid()};
}

MetalCells Metal::own_cells(Level const& level) const {
  return cells(level, {level.boxes().begin() + level.first_local_box(), level.boxes().begin() + level.last_local_box()});
}

}  // namespace amrpic
