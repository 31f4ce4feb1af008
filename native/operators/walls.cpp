#include "operators/walls.hpp"

#include "stencil/field_difference.hpp"
#include "stencil/laplacian.hpp"

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

void subtract_from_laplacian(Walls const& walls, WallGhosts const& ghosts, Equation const& equation,
                             std::vector<Real>& f) {
  for (std::size_t i = 0; i < walls.faces.size(); ++i) {
    auto const& face = walls.faces[i];
    f[face.row] -= datum_weight(equation, face.axis, ghosts[face.axis][face.side]) * walls.datum[i];
  }
}

void add_to_field(Walls const& walls, WallGhosts const& ghosts, Real3 const& spacing, int axis,
                  std::vector<char> const& uncovered, bool which, Real* e) {
  for (std::size_t i = 0; i < walls.faces.size(); ++i) {
    auto const& face = walls.faces[i];
    if (face.axis != axis || bool(uncovered[face.row]) != which) continue;
    Real const ghost = ghosts[axis][face.side].datum * walls.datum[i], factor = field_factor(spacing[axis]);
    e[face.row] += face.side == 0 ? field_between(factor, ghost, 0.0) : field_between(factor, 0.0, ghost);
  }
}

}  // namespace amrpic
