#include "particle/particle_mesh.hpp"

#include <algorithm>
#include <stdexcept>

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
  Index3 const parent = cell_parent(cell), other = nearest_other_parent(cell);
  for (int corner = 0; corner < 8; ++corner) {
    Index3 c;
    for (int d = 0; d < 3; ++d) c[d] = (corner >> d) & 1 ? other[d] : parent[d];
    c = coarser.fold_at_walls(c);
    if (numbers(c) == no_cell)
      throw std::logic_error("cell " + to_string(c) + " beside a finer level does not exist, although levels nest");
    out.coarse[std::size_t(out.parents.offset(c))] = numbers(c);
  }
}

Numbered number_ghosts(Hierarchy const& hierarchy, int l, int b) {
  Level const& level = hierarchy.level(l);
  Box const& box = level.box(b);
  auto const numbers = cell_numbers(level, box.grow(tile_reach));
  Numbered out;
  std::vector<Index3> missing;  // ghost cells that the level lacks
  for_each_ghost_row(box, [&](int first, int last, int j, int k) {
    for (int i = first; i <= last; ++i) {
      Index3 const cell = level.fold_at_walls({i, j, k});
      out.ghosts.push_back(numbers(cell));
      if (numbers(cell) == no_cell) missing.push_back(cell);
    }
  });
  if (missing.empty()) return out;

  Level const& coarser = hierarchy.level(l - 1);
  out.parents = box.coarsen(refinement_ratio).grow(1);
  out.coarse.assign(std::size_t(out.parents.cells()), no_cell);
  auto const coarse_numbers = cell_numbers(coarser, out.parents);
  for (Index3 const& cell : missing) mark_coarse(out, coarse_numbers, coarser, cell);
  return out;
}

}  // namespace

ParticleMesh::ParticleMesh(std::shared_ptr<Hierarchy const> hierarchy)
    : hierarchy_(std::move(hierarchy)), locator_(hierarchy_), transfer_(hierarchy_) {
  int const levels = hierarchy_->level_count();
  std::vector<Numbered> numbered;
  for (int l = 0; l < levels; ++l) {
    first_slot_.push_back(int(boxes_.size()));
    Level const& level = hierarchy_->level(l);
    for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
      numbered.push_back(number_ghosts(*hierarchy_, l, b));
      boxes_.push_back({l, b, {}, numbered.back().parents, {}});
      homes_.emplace_back(locator_, l, b);
      first_brick_.push_back(bricks() + homes_.back().bricks());
    }
  }
  for (int l = 0; l < levels; ++l) {
    Level const& level = hierarchy_->level(l);
    CellReads reads(level);
    reads.add(
        level, [](Box const& o) { return o.grow(tile_reach); },
        [&](int b, auto&& read) { read(level.box(b).grow(tile_reach)); });
    if (hierarchy_->has_finer(l)) {
      Level const& finer = hierarchy_->level(l + 1);
      reads.add_numbers(
          finer, [](Box const& o) { return o.grow(1).refine(refinement_ratio); },
          [&](int b) {
            bool const here = finer.owner(b) == finer.rank();
            return here ? numbered[std::size_t(slot(l + 1, b))].coarse : number_ghosts(*hierarchy_, l + 1, b).coarse;
          });
    }
    halos_.emplace_back(hierarchy_->comm(), reads);
  }
  for (std::size_t s = 0; s < boxes_.size(); ++s) {
    BoxGhosts& at = boxes_[s];
    Halo const& halo = halos_[at.level];
    at.ghosts = GhostCells(hierarchy_->level(at.level).box(at.box), halo.local(numbered[s].ghosts), halo.owned());
    if (at.level > 0) at.coarse = halos_[at.level - 1].local(numbered[s].coarse);
  }
}

BufferZone const& ParticleMesh::buffer_zone() {
  if (!buffer_zone_) buffer_zone_ = std::make_unique<BufferZone const>(*hierarchy_);
  return *buffer_zone_;
}

BoundaryPlaces const& ParticleMesh::boundary_places(bool matched) {
  auto& places = matched ? with_matched_ : without_matched_;
  if (!places) places = std::make_unique<BoundaryPlaces const>(*this, matched ? &buffer_zone() : nullptr);
  return *places;
}

}  // namespace amrpic
