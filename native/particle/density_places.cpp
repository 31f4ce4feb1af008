#include "particle/density_places.hpp"

namespace amrpic {

namespace {

/// Numbers of a level's cells in a region, of wall cells for what lies behind walls.
std::vector<GlobalIndex> folded_numbers(Level const& level, Box const& region) {
  auto const numbers = cell_numbers(level, region);
  std::vector<GlobalIndex> out;
  out.reserve(numbers.values().size());
  for_each_cell(region, [&](Index3 const& cell) { out.push_back(numbers(level.fold_at_walls(cell))); });
  return out;
}

}  // namespace

DensityPlaces::DensityPlaces(Hierarchy const& hierarchy, BufferZone const* zone) {
  auto const read_by_matched = [&](int l, CellReads& reads) {
    for (int r = 1; l + r < hierarchy.level_count(); ++r) {
      Level const& finer = hierarchy.level(l + r);
      reads.add_numbers(
          finer,
          [&](Box const& o) {
            Box out = o.grow(reach);
            for (int n = 0; n < r; ++n) out = out.refine(refinement_ratio);
            return out;
          },
          [&](int b) {
            BoxBuffer const buffer = buffer_of(hierarchy, l + r, finer.box(b));
            return int(buffer.coarse.size()) < r
                       ? std::vector<GlobalIndex>{}
                       : folded_numbers(hierarchy.level(l), buffer.coarse[std::size_t(r) - 1].box.grow(reach));
          });
    }
  };
  plan_ = zone ? ghost_plan(hierarchy, reach, read_by_matched) : ghost_plan(hierarchy, reach);
  matched_.resize(plan_.boxes.size());
  for (std::size_t s = 0; zone && s < matched_.size(); ++s)
    if (BoxBuffer const* const buffer = zone->box(s))
      for (CoarseCells const& c : buffer->coarse)
        matched_[s].push_back(halo(c.level).local(folded_numbers(hierarchy.level(c.level), c.box.grow(reach))));
}

}  // namespace amrpic
