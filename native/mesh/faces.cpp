#include "mesh/faces.hpp"

#include "mesh/box_set.hpp"
#include "mesh/hierarchy.hpp"

namespace amrpic {

namespace {

Index3 halved(Index3 const& shift) { return {shift[0] / 2, shift[1] / 2, shift[2] / 2}; }

}  // namespace

std::vector<Overlap> overlaps(Level const& level, Box const& region) {
  std::vector<Overlap> out;
  level.for_each_overlap(region, [&](int b, Box const& part, Index3 const& shift) { out.push_back({b, part, shift}); });
  return out;
}

BoxFaces::BoxFaces(Level const& level, Box const& box, Level const* finer) : box(box) {
  for (int axis = 0; axis < 3; ++axis)
    for (int side = 0; side < 2; ++side) {
      Face& face = sides[std::size_t(2 * axis + side)];
      face.layer = box.layer(axis, side, 1);
      face.is_wall = level.is_at_wall(box, axis, side);
      if (face.is_wall) continue;
      face.neighbours = overlaps(level, face.layer);
      GlobalIndex missing = face.layer.cells();
      for (Overlap const& o : face.neighbours) missing -= o.part.cells();
      face.has_coarser = missing > 0;
    }
  if (finer) find_finer(*finer);
}

void BoxFaces::find_finer(Level const& finer) {
  auto const near = overlaps(finer, box.grow(1).refine(refinement_ratio));
  for (Overlap const& o : near) {
    Box const part = o.part.coarsen(refinement_ratio).intersect(box);
    if (!part.empty()) covered.push_back({o.box, part, halved(o.shift)});
  }
  if (is_fully_covered()) return;
  // By axis and side first, so that a cell with several such faces adds their fluxes in one order for all box sizes.
  for (int axis = 0; axis < 3; ++axis)
    for (int side = 1; side >= 0; --side)
      for (Overlap const& o : near) {
        Box const parents = finer.box(o.box).shift(o.shift).coarsen(refinement_ratio);
        Box const candidates = parents.layer(axis, 1 - side, 1).intersect(box);
        if (candidates.empty()) continue;
        std::vector<Box> uncovered{candidates};
        for (Overlap const& c : covered)
          if (!c.part.intersect(candidates).empty()) uncovered = without(uncovered, c.part);
        for (Box const& cells : uncovered) beside.push_back({axis, side, {o.box, cells, halved(o.shift)}});
      }
}

bool BoxFaces::is_fully_covered() const {
  GlobalIndex uncovered = box.cells();
  for (Overlap const& o : covered) uncovered -= o.part.cells();
  return uncovered == 0;
}

ArrayOnBox<char> BoxFaces::covered_cells() const {
  ArrayOnBox<char> out(box, 0);
  for (Overlap const& o : covered) out.fill(o.part, 1);
  return out;
}

bool BoxFaces::ends_level() const {
  return std::any_of(sides.begin(), sides.end(), [](Face const& face) { return face.has_coarser; });
}

LevelFaces faces_of_boxes(Level const& level, Level const* finer) {
  LevelFaces out;
  out.reserve(std::size_t(level.last_local_box() - level.first_local_box()));
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b) out.emplace_back(level, level.box(b), finer);
  return out;
}

ArrayOnBox<CellFaces> cell_faces(BoxFaces const& faces) {
  ArrayOnBox<CellFaces> out(faces.box, {});
  auto set = [&](Box const& cells, int axis, int side, Beyond what) {
    for_each_cell(cells, [&](Index3 const& cell) { out(cell).set(axis, side, what); });
  };
  for (int axis = 0; axis < 3; ++axis)
    for (int side = 0; side < 2; ++side) {
      Face const& face = faces.sides[std::size_t(2 * axis + side)];
      Box const cells = faces.box.layer(axis, side, 0);
      if (face.is_wall) set(cells, axis, side, Beyond::wall);
      if (!face.has_coarser) continue;
      set(cells, axis, side, Beyond::coarser);
      for (Overlap const& o : face.neighbours) set(o.part.layer(axis, 1 - side, 1), axis, side, Beyond::same_level);
    }
  for (FinerNeighbour const& n : faces.beside) set(n.cells.part, n.axis, n.side, Beyond::finer);
  for (Overlap const& o : faces.covered) for_each_cell(o.part, [&](Index3 const& cell) { out(cell).set_covered(); });
  return out;
}

}  // namespace amrpic
