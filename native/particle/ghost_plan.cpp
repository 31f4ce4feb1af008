#include "particle/ghost_plan.hpp"

#include "base/error.hpp"
#include "mesh/array_on_box.hpp"

namespace amrpic {

namespace {

/// Ghost cells by global numbers, before it is known where their values are stored.
struct Numbered {
  std::vector<GlobalIndex> ghosts;  ///< in the order of `for_each_ghost_row`; `no_cell`: the level has none
  Box parents;
  std::vector<GlobalIndex> coarse;  ///< `no_cell`: not needed
};

/// Mark the coarse cells that deposit and gather use for a ghost cell that its level lacks.
void mark_coarse(Numbered& out, ArrayOnBox<GlobalIndex> const& numbers, Level const& coarser, Index3 const& cell) {
  Index3 const parent = parent_of(cell), other = nearest_other_parent(cell);
  for (int corner = 0; corner < 8; ++corner) {
    Index3 c;
    for (int d = 0; d < 3; ++d) c[d] = (corner >> d) & 1 ? other[d] : parent[d];
    c = coarser.fold_at_walls(c);
    if (numbers(c) == no_cell && c == coarser.fold_at_walls(parent))
      fail_alone("cell " + to_string(c) + " beside a finer level does not exist, although levels nest");
    out.coarse[std::size_t(out.parents.offset(c))] = numbers(c);
  }
}

Numbered number_ghosts(Hierarchy const& hierarchy, int l, int b, int reach) {
  Level const& level = hierarchy.level(l);
  Box const& box = level.box(b);
  auto const numbers = cell_numbers(level, box.grow(reach));
  Numbered out;
  std::vector<Index3> missing;  // ghost cells that the level lacks
  for_each_ghost_row(
      box,
      [&](int first, int last, int j, int k) {
        for (int i = first; i <= last; ++i) {
          Index3 const cell = level.fold_at_walls({i, j, k});
          out.ghosts.push_back(numbers(cell));
          if (numbers(cell) == no_cell) missing.push_back(cell);
        }
      },
      reach);
  if (missing.empty()) return out;

  Level const& coarser = hierarchy.level(l - 1);
  out.parents = box.coarsen(refinement_ratio).grow(reach);
  out.coarse.assign(std::size_t(out.parents.cells()), no_cell);
  auto const coarse_numbers = cell_numbers(coarser, out.parents);
  for (Index3 const& cell : missing) mark_coarse(out, coarse_numbers, coarser, cell);
  return out;
}

}  // namespace

GhostPlan ghost_plan(Hierarchy const& hierarchy, int reach, std::function<void(int, CellReads&)> const& more) {
  GhostPlan out;
  int const levels = hierarchy.level_count();
  std::vector<Numbered> numbered;
  std::vector<std::size_t> first_slot;
  for (int l = 0; l < levels; ++l) {
    first_slot.push_back(numbered.size());
    for (int b = hierarchy.level(l).first_local_box(); b < hierarchy.level(l).last_local_box(); ++b) {
      numbered.push_back(number_ghosts(hierarchy, l, b, reach));
      out.boxes.push_back({l, b, {}, numbered.back().parents, {}});
    }
  }
  for (int l = 0; l < levels; ++l) {
    Level const& level = hierarchy.level(l);
    CellReads reads(level);
    reads.add(
        level, [&](Box const& o) { return o.grow(reach); },
        [&](int b, auto&& read) { read(level.box(b).grow(reach)); });
    if (hierarchy.has_finer(l)) {
      Level const& finer = hierarchy.level(l + 1);
      reads.add_numbers(
          finer, [&](Box const& o) { return o.grow(reach).refine(refinement_ratio); },
          [&](int b) {
            bool const here = finer.owner(b) == finer.rank();
            return here ? numbered[first_slot[std::size_t(l + 1)] + std::size_t(b - finer.first_local_box())].coarse
                        : number_ghosts(hierarchy, l + 1, b, reach).coarse;
          });
    }
    if (more) more(l, reads);
    out.halos.emplace_back(hierarchy.comm(), reads);
  }
  for (std::size_t s = 0; s < out.boxes.size(); ++s) {
    BoxGhosts& at = out.boxes[s];
    Halo const& halo = out.halos[std::size_t(at.level)];
    Box const& box = hierarchy.level(at.level).box(at.box);
    at.ghosts = GhostCells(box, halo.local(numbered[s].ghosts), halo.owned(), reach);
    if (at.level > 0) at.coarse = out.halos[std::size_t(at.level) - 1].local(numbered[s].coarse);
  }
  return out;
}

}  // namespace amrpic
