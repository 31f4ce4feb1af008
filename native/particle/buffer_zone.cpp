#include "particle/buffer_zone.hpp"

#include <algorithm>

#include "base/error.hpp"

namespace amrpic {

namespace {

/// The cell that holds `cell` so many levels up.
Index3 ancestor(Index3 const& cell, int levels) {
  int const scale = 1 << levels;
  return {floor_divide(cell[0], scale), floor_divide(cell[1], scale), floor_divide(cell[2], scale)};
}

/// 1 for the cells of `region` that have an uncovered cell among their 26 neighbours inside the domain.
ArrayOnBox<char> beside_uncovered(Level const& level, Level const& finer, Box const& region) {
  auto const covered = covered_cells(finer, refinement_ratio, region.grow(1));
  ArrayOnBox<char> out(region, 0);
  for_each_cell(region, [&](Index3 const& cell) {
    for_each_cell(Box{cell, cell}.grow(1), [&](Index3 const& other) {
      if (!covered(level.fold_at_walls(other))) out(cell) = 1;
    });
  });
  return out;
}

/// Mark the buffer cells in a region of level l; true if there are any.
bool mark(Hierarchy const& hierarchy, int l, Box region, ArrayOnBox<char>& depth) {
  depth = ArrayOnBox<char>(region.coarsen(refinement_ratio), 0);
  bool any = true;
  for (int r = 1; r <= l && any; ++r) {
    region = region.coarsen(refinement_ratio);
    auto const edge = beside_uncovered(hierarchy.level(l - r), hierarchy.level(l - r + 1), region);
    any = false;
    for_each_cell(depth.box(), [&](Index3 const& parent) {
      if (depth(parent) == r - 1 && edge(ancestor(parent, r - 1))) depth(parent) = char(r), any = true;
    });
  }
  auto const& values = depth.values();
  return std::any_of(values.begin(), values.end(), [](char r) { return r > 0; });
}

/// Numbers of the cells of level l - r that clouds r levels coarser touch, in the box grown by the reach; `no_cell`
/// where none does. What overhangs a wall is folded onto the wall cell.
std::vector<GlobalIndex> touched(Level const& coarse, Box const& box, ArrayOnBox<char> const& depth, int r) {
  ArrayOnBox<char> wanted(box.grow(tile_reach), 0);
  for_each_cell(depth.box(), [&](Index3 const& parent) {
    if (depth(parent) != r) return;
    Index3 const at = ancestor(parent, r - 1);
    for_each_cell(Box{at, at}.grow(tile_reach), [&](Index3 const& cell) { wanted(cell) = 1; });
  });
  auto const numbers = cell_numbers(coarse, wanted.box());
  std::vector<GlobalIndex> out;
  out.reserve(wanted.values().size());
  for_each_cell(wanted.box(), [&](Index3 const& cell) {
    out.push_back(wanted(cell) ? numbers(coarse.fold_at_walls(cell)) : no_cell);
    if (wanted(cell) && out.back() == no_cell)
      fail_alone("cell " + to_string(cell) + " beside a covered one does not exist, although levels nest");
  });
  return out;
}

/// The buffer of box b of level l, and for each of its coarser levels the numbers of the cells that are touched.
std::pair<BoxBuffer, std::vector<std::vector<GlobalIndex>>> buffer_of_box(Hierarchy const& hierarchy, int l, int b) {
  std::pair<BoxBuffer, std::vector<std::vector<GlobalIndex>>> out{buffer_of(hierarchy, l, hierarchy.level(l).box(b)),
                                                                  {}};
  auto& [buffer, numbers] = out;
  for (std::size_t r = 1; r <= buffer.coarse.size(); ++r) {
    CoarseCells const& c = buffer.coarse[r - 1];
    numbers.push_back(touched(hierarchy.level(c.level), c.box, buffer.depth, int(r)));
  }
  return out;
}

}  // namespace

BoxBuffer buffer_of(Hierarchy const& hierarchy, int l, Box const& region) {
  BoxBuffer out;
  if (l == 0 || !mark(hierarchy, l, region, out.depth)) return out;
  auto const& depths = out.depth.values();
  Box box = region;
  for (int r = 1; r <= *std::max_element(depths.begin(), depths.end()); ++r) {
    box = box.coarsen(refinement_ratio);
    out.coarse.push_back({l - r, box, {}});
  }
  return out;
}

BufferZone::BufferZone(Hierarchy const& hierarchy) {
  int const levels = hierarchy.level_count();
  std::vector<std::vector<std::vector<GlobalIndex>>> numbers;  // like boxes_[].coarse[].place
  std::vector<std::size_t> first_slot;
  for (int l = 0; l < levels; ++l) {
    first_slot.push_back(boxes_.size());
    for (int b = hierarchy.level(l).first_local_box(); b < hierarchy.level(l).last_local_box(); ++b) {
      auto [buffer, of_box] = buffer_of_box(hierarchy, l, b);
      boxes_.push_back(std::move(buffer));
      numbers.push_back(std::move(of_box));
    }
  }
  for (int l = 0; l < levels; ++l) {
    CellReads reads(hierarchy.level(l));
    for (int r = 1; l + r < levels; ++r) {
      Level const& finer = hierarchy.level(l + r);
      reads.add_numbers(
          finer,
          [&](Box const& o) {
            Box out = o.grow(tile_reach);
            for (int n = 0; n < r; ++n) out = out.refine(refinement_ratio);
            return out;
          },
          [&](int b) {
            auto const of_box = finer.owner(b) == finer.rank()
                                    ? numbers[first_slot[std::size_t(l + r)] + std::size_t(b - finer.first_local_box())]
                                    : buffer_of_box(hierarchy, l + r, b).second;
            return int(of_box.size()) < r ? std::vector<GlobalIndex>{} : of_box[std::size_t(r - 1)];
          });
    }
    halos_.emplace_back(hierarchy.comm(), reads);
  }
  for (std::size_t s = 0; s < boxes_.size(); ++s)
    for (std::size_t r = 0; r < boxes_[s].coarse.size(); ++r) {
      CoarseCells& coarse = boxes_[s].coarse[r];
      coarse.place = halos_[coarse.level].local(numbers[s][r]);
    }
}

}  // namespace amrpic
