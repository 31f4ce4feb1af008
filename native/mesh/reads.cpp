#include "mesh/reads.hpp"

#include "mesh/hierarchy.hpp"
#include "stencil/interface.hpp"

namespace amrpic {

namespace {

/// Call f(faces) for any box of a level; those of own boxes are known.
template <class F>
void with_faces(Level const& level, LevelFaces const& own, Level const* finer, int b, F&& f) {
  if (level.owner(b) == level.rank())
    f(own[std::size_t(b - level.first_local_box())]);
  else
    f(BoxFaces(level, level.box(b), finer));
}

}  // namespace

Reads reads_beyond_faces(Level const& level) {
  return reads_across_ranks(
      level, level, [](Box const& o) { return o.grow(1); },
      [&](int b, auto&& read) {
        for (int face = 0; face < 6; ++face) read(level.box(b).layer(face / 2, face % 2, 1));
      });
}

Reads reads_behind_edges(Level const& level, LevelFaces const& own, Level const& coarser) {
  return reads_across_ranks(
      level, coarser, [](Box const& o) { return o.grow(1 + plane_reach).refine(refinement_ratio); },
      [&](int b, auto&& read) {
        with_faces(level, own, nullptr, b, [&](BoxFaces const& faces) {
          for (int face = 0; face < 6; ++face) {
            Index3 along{plane_reach, plane_reach, plane_reach};
            along[face / 2] = 0;
            Face const& f = faces.sides[std::size_t(face)];
            read(f.has_coarser ? f.layer.coarsen(refinement_ratio).grow(along) : Box{});
          }
        });
      });
}

Reads reads_of_fine_fluxes(Level const& level, LevelFaces const& own, Level const& finer) {
  Reads out;
  int const me = level.rank();
  auto add = [&](int b, std::vector<Read>& list, auto&& is_meant) {
    with_faces(level, own, &finer, b, [&](BoxFaces const& faces) {
      int place = 0;
      for (FinerNeighbour const& n : faces.beside) {
        int const owner = finer.owner(n.cells.box), face = 2 * n.axis + 1 - n.side;
        if (is_meant(owner))
          list.push_back(
              {owner == me ? level.owner(b) : owner, b, n.cells.box, 6 * place + face, n.cells.part, n.cells.shift});
        ++place;
      }
    });
  };
  if (level.ranks() == 1) return out;
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b)
    add(b, out.wanted, [&](int owner) { return owner != me; });
  for_each_reader(
      level, finer, [](Box const& o) { return o.coarsen(refinement_ratio).grow(1); },
      [&](int b) { add(b, out.asked, [&](int owner) { return owner == me; }); });
  out.sort();
  return out;
}

}  // namespace amrpic
