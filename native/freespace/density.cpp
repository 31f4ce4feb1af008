#include "freespace/density.hpp"

#include <utility>

namespace amrpic::freespace {

std::vector<ChargeBox> charges_of(Field const& density, Hierarchy const& hierarchy, double factor) {
  std::vector<ChargeBox> out;
  for (int l = 0; l < hierarchy.level_count(); ++l) {
    Level const& level = hierarchy.level(l);
    LocalIndex first = 0;
    for (BoxFaces const& faces : hierarchy.faces(l)) {
      Box const& box = faces.box;
      ChargeBox charge{l, box.lower, box.upper, &density.level(l)[first], factor * level.cell_volume()};
      for (Overlap const& o : faces.covered) charge.covered.push_back({o.part.lower, o.part.upper});
      out.push_back(std::move(charge));
      first += LocalIndex(box.cells());
    }
  }
  return out;
}

WallMesh wall_mesh(Hierarchy const& hierarchy, int layers) {
  Domain const& domain = hierarchy.domain();
  WallMesh out{{domain.lower, hierarchy.level(0).spacing(), domain.cells}, {}, {}};
  for (int face = 0; face < 6; ++face)
    out.open[std::size_t(face)] = domain.boundary[face / 2][face % 2] == Boundary::open;
  for (int l = 0; l < hierarchy.level_count(); ++l) out.levels.push_back(hierarchy.share_level(l));
  out.layers = layers;
  return out;
}

}  // namespace amrpic::freespace
