#include "particle/density_places.hpp"

#include <algorithm>
#include <tuple>
#include <utility>

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

/// Whether block b continues a along an axis, in space and in memory, where the first `owned` places are own ones.
bool continues(CellBlock const& a, CellBlock const& b, int axis, LocalIndex owned) {
  auto const kind = [&](CellBlock const& of) { return of.place < 0 ? 0 : of.place < owned ? 1 : 2; };
  if (kind(a) != kind(b) || b.cells.lower[axis] != a.cells.upper[axis] + 1) return false;
  for (int d = 0; d < 3; ++d) {
    if (d == axis) continue;
    if (a.cells.lower[d] != b.cells.lower[d] || a.cells.upper[d] != b.cells.upper[d]) return false;
    if (a.place >= 0 && a.cells.extent(d) > 1 && a.stride[d] != b.stride[d]) return false;
  }
  if (a.place < 0) return true;
  LocalIndex const length = a.cells.extent(axis), between = b.place - a.place;
  LocalIndex const stride = axis == 0 ? 1 : length > 1 ? a.stride[axis] : between;
  return between == stride * length && (b.cells.extent(axis) == 1 || b.stride[axis] == stride);
}

/// Join blocks that continue others along an axis.
void join(std::vector<CellBlock>& blocks, int axis, LocalIndex owned) {
  int const u = (axis + 1) % 3, v = (axis + 2) % 3;
  auto const key = [&](CellBlock const& of) {
    Box const& c = of.cells;
    return std::make_tuple(c.lower[u], c.upper[u], c.lower[v], c.upper[v], c.lower[axis]);
  };
  std::sort(blocks.begin(), blocks.end(), [&](CellBlock const& a, CellBlock const& b) { return key(a) < key(b); });
  std::vector<CellBlock> out;
  for (CellBlock const& block : blocks) {
    if (out.empty() || !continues(out.back(), block, axis, owned)) {
      out.push_back(block);
      continue;
    }
    CellBlock& last = out.back();
    if (last.cells.extent(axis) == 1) last.stride[axis] = block.place - last.place;
    last.cells.upper[axis] = block.cells.upper[axis];
  }
  blocks = std::move(out);
}

std::vector<CellBlock> blocks_of(GhostCells const& ghosts, LocalIndex owned) {
  std::vector<CellBlock> out;
  for (GhostRun const& run : ghosts.runs()) {
    CellBlock block{{run.first, run.cell(run.count - 1)}, run.place, {1, 1, 1}};
    block.stride[run.axis] = run.place_stride;
    out.push_back(block);
  }
  for (int axis : {0, 1, 2}) join(out, axis, owned);
  std::stable_sort(out.begin(), out.end(),
                   [](CellBlock const& a, CellBlock const& b) { return a.cells.lower[2] < b.cells.lower[2]; });
  return out;
}

/// Whether each coarse cell exists between which those of some blocks are interpolated.
bool has_all_coarse(std::vector<CellBlock> const& blocks, BoxGhosts const& at) {
  for (CellBlock const& block : blocks) {
    if (block.place >= 0) continue;
    bool all = true;
    for_each_cell(block.cells, [&](Index3 const& cell) {
      for_each_coarse_around(
          cell, [&](Index3 const& from, Real) { all &= at.coarse[std::size_t(at.parents.offset(from))] >= 0; });
    });
    if (!all) return false;
  }
  return true;
}

/// Cells whose numbers and places both follow each other; negative places are left out, the first `owned` are own.
std::vector<DensityPlaces::OfBox::CoarseRow> rows_of(std::vector<LocalIndex> const& places, LocalIndex owned) {
  std::vector<DensityPlaces::OfBox::CoarseRow> out;
  for (std::size_t n = 0; n < places.size(); ++n) {
    LocalIndex const number = LocalIndex(n), place = places[n];
    if (place < 0) continue;
    bool const follows = !out.empty() && number == out.back().number + out.back().count &&
                         place == out.back().place + out.back().count && place != owned;
    if (follows)
      ++out.back().count;
    else
      out.push_back({number, place, 1});
  }
  return out;
}

/// `owned`, `coarse_owned`: own cells of the box's level, and of the coarser one.
DensityPlaces::OfBox places_of(Hierarchy const& hierarchy, BoxGhosts const& at, LocalIndex owned,
                               LocalIndex coarse_owned) {
  Level const& level = hierarchy.level(at.level);
  Box const cells = level.box(at.box).grow(DensityPlaces::reach);
  DensityPlaces::OfBox out{at.level, at.box, blocks_of(at.ghosts, owned), at.parents, {}, false};
  out.whole = level.cut_at_walls(cells) == cells && has_all_coarse(out.ghosts, at);
  if (at.level > 0) out.coarse = rows_of(at.coarse, coarse_owned);
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
  GhostPlan plan = zone ? ghost_plan(hierarchy, reach, read_by_matched) : ghost_plan(hierarchy, reach);
  halos_ = std::move(plan.halos);
  for (BoxGhosts const& at : plan.boxes)
    boxes_.push_back(places_of(hierarchy, at, halo(at.level).owned(), halo(std::max(0, at.level - 1)).owned()));
  matched_.resize(boxes_.size());
  for (std::size_t s = 0; zone && s < matched_.size(); ++s)
    if (BoxBuffer const* const buffer = zone->box(s))
      for (CoarseCells const& c : buffer->coarse)
        matched_[s].push_back(halo(c.level).local(folded_numbers(hierarchy.level(c.level), c.box.grow(reach))));
}

}  // namespace amrpic
