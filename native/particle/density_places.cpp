#include "particle/density_places.hpp"

namespace amrpic {

namespace {

/// Places of a level's cells in a region, of wall cells for what lies behind walls.
std::vector<LocalIndex> folded_places(Halo const& halo, Level const& level, Box const& region) {
  auto const places = halo.places(level, region);
  std::vector<LocalIndex> out;
  out.reserve(places.values().size());
  for_each_cell(region, [&](Index3 const& cell) { out.push_back(places(level.fold_at_walls(cell))); });
  return out;
}

/// Whether all cells exist between which ghost cells are interpolated, none behind a wall.
bool has_whole_surroundings(Level const& level, BoxGhosts const& at) {
  Box const cells = level.box(at.box).grow(DensityPlaces::reach);
  bool all = level.cut_at_walls(cells) == cells;
  for (GhostRun const& run : at.ghosts.runs())
    for (LocalIndex n = 0; run.place < 0 && n < run.count; ++n)
      for_each_coarse_around(run.cell(n), [&](Index3 const& from, Real) {
        all = all && at.coarse[std::size_t(at.parents.offset(from))] >= 0;
      });
  return all;
}

}  // namespace

DensityPlaces::DensityPlaces(Hierarchy const& hierarchy, BufferZone const* zone) {
  auto const read_by_matched = [&](int l, CellReads& reads) {
    for (int r = 1; l + r < hierarchy.level_count(); ++r) {
      Level const& finer = hierarchy.level(l + r);
      reads.add(
          finer,
          [&](Box const& o) {
            return o.grow(reach).refine({1 << r, 1 << r, 1 << r});
          },
          [&](int b, auto&& read) {
            BoxBuffer const buffer = buffer_of(hierarchy, l + r, finer.box(b));
            if (int(buffer.coarse.size()) >= r) read(buffer.coarse[std::size_t(r) - 1].box.grow(reach));
          });
    }
  };
  plan_ = zone ? ghost_plan(hierarchy, reach, read_by_matched) : ghost_plan(hierarchy, reach);
  for (BoxGhosts const& at : plan_.boxes) whole_.push_back(has_whole_surroundings(hierarchy.level(at.level), at));
  matched_.resize(plan_.boxes.size());
  for (std::size_t s = 0; zone && s < matched_.size(); ++s)
    if (BoxBuffer const* const buffer = zone->box(s))
      for (CoarseCells const& c : buffer->coarse)
        matched_[s].push_back(folded_places(halo(c.level), hierarchy.level(c.level), c.box.grow(reach)));
}

}  // namespace amrpic
