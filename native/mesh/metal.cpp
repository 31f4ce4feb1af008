#include "mesh/metal.hpp"

#include <algorithm>

namespace amrpic {

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
  return region.empty() ? MetalCells{} : ask_(region, level.spacing());
}

MetalCells Metal::own_cells(Level const& level) const {
  return cells(level, {level.boxes().begin() + level.first_local_box(), level.boxes().begin() + level.last_local_box()});
}

}  // namespace amrpic
