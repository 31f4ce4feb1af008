#include "solver/wall_charges.hpp"

#include <algorithm>

#include "base/constants.hpp"

namespace amrpic {

namespace {

/// Charge per area of each layer of cells at a wall for a datum of 1, over eps0, times the spacing for a potential.
///
/// A charge of 2 V / h and its image, h apart, are a dipole layer across which the potential jumps by 2 V; so it is
/// what the row of the wall has, 8/3, times its weight. What a slope g makes is twice that of a charge g, with its
/// image. A wave e^{-kz} of means over cells then comes out to fourth order of kh from 2 V in one layer, as sinh(kh/2)
/// is both the mean and the pair, and from 13/12 and -1/12 of g in two, whose second moment is that of the mean.
std::vector<Real> layers_of(Boundary kind, int order) {
  if (kind == Boundary::dirichlet) return {2};
  if (order == 4) return {13.0 / 12, -1.0 / 12};
  return {1};
}

/// What charge of a cell counts for walls other than its own.
Real weight_at_others(Hierarchy const& hierarchy, int l, Index3 const& cell, Walls::Face const& own,
                      std::vector<double> const& weights) {
  Box const& all = hierarchy.level(l).domain();
  Real out = 1;
  for (int axis = 0; axis < 3; ++axis)
    for (int side = 0; side < 2; ++side) {
      if (hierarchy.domain().boundary[axis][side] != Boundary::dirichlet) continue;
      if (axis == own.axis && side == own.side) continue;
      int const depth = side == 0 ? cell[axis] - all.lower[axis] : all.upper[axis] - cell[axis];
      if (std::size_t(depth) < weights.size()) out *= weights[std::size_t(depth)];
    }
  return out;
}

}  // namespace

std::vector<std::vector<freespace::ChargeBox::Added>> wall_charges(Hierarchy const& hierarchy,
                                                                   std::vector<Walls> const& walls,
                                                                   freespace::PerFace const& beyond,
                                                                   freespace::Options const& options) {
  std::vector<double> const weights = options.at_dirichlet_walls();
  std::vector<std::vector<freespace::ChargeBox::Added>> out;
  bool is_any = false;
  for (int l = 0; l < hierarchy.level_count(); ++l) {
    Level const& level = hierarchy.level(l);
    std::size_t const first_box = out.size();
    out.resize(first_box + std::size_t(level.last_local_box() - level.first_local_box()));
    std::size_t count;  // of the faces of a box at a wall, which come one after the other, x fastest
    for (std::size_t first = 0; first < walls[l].faces.size(); first += count) {
      Walls::Face const& face = walls[l].faces[first];
      int const b = level.find(face.cell);
      Box const& box = level.box(b);
      count = std::size_t(box.layer(face.axis, face.side, 0).cells());
      if (face.kind != Boundary::dirichlet && face.kind != Boundary::neumann) continue;
      auto const given = walls[l].datum.begin() + std::ptrdiff_t(first);
      Real const h = level.spacing()[face.axis];
      bool const is_potential = face.kind == Boundary::dirichlet;
      Real const taken_out = is_potential ? beyond[face.axis][face.side] : 0;
      if (std::all_of(given, given + std::ptrdiff_t(count), [&](Real v) { return v == taken_out; })) continue;
      is_any = true;
      std::vector<Real> layers = layers_of(face.kind, options.operator_order);
      if (std::size_t(box.extent(face.axis)) < layers.size()) layers = {1};  // the next cells are in another box
      for (std::size_t n = 0; n < layers.size(); ++n) {
        Box const cells = box.layer(face.axis, face.side, -int(n));
        freespace::ChargeBox::Added added{{cells.lower, cells.upper}, {}};
        Real const factor = vacuum_permittivity * layers[n] / (is_potential ? h * h : h);
        auto datum = given;
        for_each_cell(cells, [&](Index3 const& cell) {
          added.values.push_back(factor * weight_at_others(hierarchy, l, cell, face, weights) * (*datum++ - taken_out));
        });
        out[first_box + std::size_t(b - level.first_local_box())].push_back(std::move(added));
      }
    }
  }
  if (!is_any) out.clear();
  return out;
}

}  // namespace amrpic
