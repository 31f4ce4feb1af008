#include "composite/fourth_order_plan.hpp"

#include <cstring>

#include "mesh/array_on_box.hpp"

namespace amrpic {

namespace {

using fourth_order::MeansBlock;

/// The two layers of cells beyond a face.
Box beyond(Box const& box, int axis, int side) {
  return box.layer(axis, side, 1).hull(box.layer(axis, side, FourthOrderPlan::layers));
}

/// The two layers of coarser cells behind a face of a box of cells, with what blocks may reach in their planes.
Box behind(Box const& box, int axis, int side) {
  Index3 along{FourthOrderPlan::margin, FourthOrderPlan::margin, FourthOrderPlan::margin};
  along[axis] = 0;
  return beyond(box.coarsen(refinement_ratio), axis, side).grow(along);
}

Reads reads_beyond(Level const& level) {
  return reads_across_ranks(
      level, level, [](Box const& o) { return o.grow(FourthOrderPlan::layers); },
      [&](int b, auto&& read) {
        for (int face = 0; face < 6; ++face) read(beyond(level.box(b), face / 2, face % 2));
      });
}

Reads reads_behind(Level const& level, Level const& coarser) {
  return reads_across_ranks(
      level, coarser,
      [](Box const& o) { return o.grow(FourthOrderPlan::layers + FourthOrderPlan::margin).refine(refinement_ratio); },
      [&](int b, auto&& read) {
        BoxFaces const faces(level, level.box(b));
        for (int face = 0; face < 6; ++face)
          read(faces.sides[std::size_t(face)].has_coarser ? behind(level.box(b), face / 2, face % 2) : Box{});
      });
}

}  // namespace

FourthOrderPlan::FourthOrderPlan(CompositeMesh const& mesh) : levels_(std::size_t(mesh.levels())) {
  for (int l = 0; l < mesh.levels(); ++l) {
    cells.add(as_neighbours(l), reads_beyond(mesh.level(l)));
    if (l > 0) cells.add(behind_edges(l - 1), reads_behind(mesh.level(l), mesh.level(l - 1)));
  }
  cells.plan(mesh.comm());
  mesh.for_each_box([&](int l, int b) {
    levels_[std::size_t(l)].faces.emplace_back();
    levels_[std::size_t(l)].remote.push_back(0);
    BoxFaces const& faces = mesh.hierarchy().faces(l)[std::size_t(b)];
    for (int f = 0; f < 6; ++f) plan_face(mesh, l, b, f, faces.sides[std::size_t(f)]);
  });
}

void FourthOrderPlan::plan_face(CompositeMesh const& mesh, int l, int b, int f, Face const& face) {
  if (face.is_wall) return;
  OnLevel& level = levels_[std::size_t(l)];
  FacePlan& plan = level.faces.back()[std::size_t(f)];
  Box const& box = mesh.box(l, b);
  int const axis = f / 2, side = f % 2;
  auto const [u, v] = tangential_axes(axis);
  auto const add_plane = [&](int of, std::vector<Overlap> const& near, Box const& layer) {
    Range out{std::int32_t(level.rectangles.size()), 0};
    int const purpose = l == of ? as_neighbours(l) : behind_edges(of), reader = mesh.level(l).first_local_box() + b;
    for (Overlap const& o : near) {
      Overlap const met{o.box, o.part.intersect(layer), o.shift};
      if (met.part.empty()) continue;
      RegionPart const part = part_of(cells, purpose, mesh.level(of), reader, f, met);
      if (!part.here) level.remote.back() = 1;
      level.rectangles.push_back(part.across(axis, layer.lower));
    }
    out.last = std::int32_t(level.rectangles.size());
    return out;
  };
  auto const near = overlaps(mesh.level(l), beyond(box, axis, side));
  for (int n = 0; n < layers; ++n) plan.neighbours[std::size_t(n)] = add_plane(l, near, box.layer(axis, side, n + 1));
  if (!face.has_coarser) return;
  Box const parents = box.coarsen(refinement_ratio), read = behind(box, axis, side);
  plan.nu = parents.extent(u), plan.nv = parents.extent(v);
  plan.blocks = std::int32_t(level.blocks.size());
  level.blocks.resize(level.blocks.size() + std::size_t(plan.nu) * std::size_t(plan.nv));
  auto const coarse = overlaps(mesh.level(l - 1), read);
  for (int n = 0; n < layers; ++n) {
    Box layer = read;
    layer.lower[axis] = layer.upper[axis] = parents.layer(axis, side, n + 1).lower[axis];
    plan.coarse[std::size_t(n)] = add_plane(l - 1, coarse, layer);
    ArrayOnBox<char> usable(layer, 0);
    for (Overlap const& o : coarse) usable.fill(o.part, 1);
    OfCell* of_cell = level.blocks.data() + plan.blocks;
    int const pitch = layer.extent(u);
    for (int y = margin; y < margin + plan.nv; ++y)
      for (int x = margin; x < margin + plan.nu; ++x)
        (*of_cell++)[std::size_t(n)] = fourth_order::best_block([&](int du, int dv, int size) {
          char const* row = usable.values().data() + (x + du) + (y + dv) * pitch;
          for (char const* const end = row + size * pitch; row < end; row += pitch)
            if (std::memchr(row, 0, std::size_t(size))) return false;
          return true;
        });
  }
}

std::size_t FourthOrderPlan::bytes() const {
  std::size_t sum = cells.memory();
  for (auto const& l : levels_)
    sum += l.faces.capacity() * sizeof(l.faces[0]) + l.rectangles.capacity() * sizeof(Rectangle) +
           l.blocks.capacity() * sizeof(OfCell);
  return sum;
}

}  // namespace amrpic
