#include "mesh/walls.hpp"

namespace amrpic {

Real3 Walls::position(Domain const& domain, Level const& level, std::size_t face) const {
  Face const& f = faces[face];
  Real3 x;
  for (int d = 0; d < 3; ++d) x[d] = domain.lower[d] + (f.cell[d] + 0.5) * level.spacing()[d];
  Real const out = f.side == 0 ? -1 : 1;
  if (f.kind == Boundary::open)
    x[f.axis] += out * level.spacing()[f.axis];
  else
    x[f.axis] = f.side == 0 ? domain.lower[f.axis] : domain.upper[f.axis];
  return x;
}

Walls find_walls(Domain const& domain, Level const& level) {
  Walls out;
  for_each_wall(level, [&](int b, int axis, int side, GlobalIndex) {
    Box const& box = level.box(b);
    for_each_cell(box.layer(axis, side, 0), [&](Index3 const& cell) {
      out.faces.push_back(
          {level.local_offset(b) + LocalIndex(box.offset(cell)), cell, axis, side, domain.boundary[axis][side]});
    });
  });
  out.datum.assign(out.faces.size(), 0.0);
  return out;
}

}  // namespace amrpic
