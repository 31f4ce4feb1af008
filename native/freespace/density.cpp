#include "freespace/density.hpp"

#include <cmath>
#include <utility>

namespace amrpic::freespace {

namespace {

/// The layers of a box at Dirichlet walls.
void add_weights(Hierarchy const& hierarchy, int level, Box const& box, std::vector<double> const& weights,
                 std::vector<ChargeBox::Weighted>& to) {
  for (int axis = 0; axis < 3; ++axis)
    for (int side = 0; side < 2; ++side) {
      if (hierarchy.domain().boundary[axis][side] != Boundary::dirichlet) continue;
      for (std::size_t n = 0; n < weights.size(); ++n) {
        Box const cells = box.intersect(hierarchy.level(level).domain().layer(axis, side, -int(n)));
        if (!cells.empty() && weights[n] != 1) to.push_back({{cells.lower, cells.upper}, weights[n]});
      }
    }
}

}  // namespace

std::vector<ChargeBox> charges_of(Field const& density, Hierarchy const& hierarchy, double factor,
                                  Options const& options) {
  std::vector<double> const weights = options.at_dirichlet_walls();
  std::vector<ChargeBox> out;
  for (int l = 0; l < hierarchy.level_count(); ++l) {
    Level const& level = hierarchy.level(l);
    LocalIndex first = 0;
    for (BoxFaces const& faces : hierarchy.faces(l)) {
      Box const& box = faces.box;
      ChargeBox charge{l, box.lower, box.upper, &density.level(l)[first], factor * level.cell_volume()};
      for (Overlap const& o : faces.covered) charge.covered.push_back({o.part.lower, o.part.upper});
      add_weights(hierarchy, l, box, weights, charge.weighted);
      out.push_back(std::move(charge));
      first += LocalIndex(box.cells());
    }
  }
  return out;
}

WallMesh wall_mesh(Hierarchy const& hierarchy, int layers, Across const& across) {
  Domain const& domain = hierarchy.domain();
  WallMesh out{{domain.lower, hierarchy.level(0).spacing(), domain.cells}, {}, {}};
  std::array<std::array<std::optional<Mirror>, 2>, 3> walls;
  std::array<bool, 3> periodic{};
  for (int d = 0; d < 3; ++d) {
    periodic[d] = domain.periodic(d);
    for (int side = 0; side < 2; ++side) {
      Boundary const kind = domain.boundary[d][side];
      if (kind == Boundary::dirichlet || kind == Boundary::neumann)
        walls[d][side] = Mirror{side * 2 * domain.cells[d], kind == Boundary::neumann ? 1 : -1};
      if (d == across.axis && !std::isnan(across.place[side]))
        walls[d][side] =
            Mirror{int(std::lround(2 * (across.place[side] - domain.lower[d]) / domain.spacing(d))), across.sign[side]};
    }
  }
  out.images = Images(out.lattice, walls, periodic, across.axis);
  for (int face = 0; face < 6; ++face)
    out.open[std::size_t(face)] = domain.boundary[face / 2][face % 2] == Boundary::open;
  for (int l = 0; l < hierarchy.level_count(); ++l) out.levels.push_back(hierarchy.share_level(l));
  out.layers = layers;
  return out;
}

}  // namespace amrpic::freespace
