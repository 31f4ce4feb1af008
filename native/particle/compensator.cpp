#include "particle/compensator.hpp"

#include <algorithm>

#include "base/lanes.hpp"
#include "stencil/field_difference.hpp"
#include "stencil/intergrid.hpp"

namespace amrpic {

namespace {

constexpr int reach = DensityPlaces::reach;
typedef Real Cell __attribute__((vector_size(8 * Compensator::per_cell)));

/// Trilinear value at the centre of `cell`, which lies inside the domain, of a coarser level's density: at(its cell),
/// or null where that level has none; there the parent's value serves.
template <class At>
Real interpolated(Index3 const& cell, Level const& coarser, At const& at) {
  Index3 const near = cell_parent(cell), far = nearest_other_parent(cell);
  Real const of_parent = *at(coarser.fold_at_walls(near));
  Real out = 0;
  for (int corner = 0; corner < 8; ++corner) {
    Real weight = 1;
    Index3 from;
    for (int d = 0; d < 3; ++d) {
      bool const is_far = (corner >> d) & 1;
      weight *= is_far ? prolongation::far : prolongation::near;
      from[d] = is_far ? far[d] : near[d];
    }
    Real const* const value = at(coarser.fold_at_walls(from));
    out += weight * (value ? *value : of_parent);
  }
  return out;
}

/// Write the differences of a density across cells of a row, component by component.
void write_differences(Real const* density, std::ptrdiff_t y, std::ptrdiff_t z, Real3 const& factor, int count,
                       Real* out) {
  std::ptrdiff_t const step[3] = {1, y, z};
  for (int d = 0; d < 3; ++d) {
    Real const *const below = density - step[d], *const above = density + step[d];
    Real* __restrict const to = out + std::ptrdiff_t(d) * count;
    for (int i = 0; i < count; ++i) to[i] = field_between(factor[std::size_t(d)], below[i], above[i]);
  }
}

/// Add three components, `count` numbers each, to the cells of a row.
void add_to_cells(Real const* components, int count, Real* to) {
  Real const *const x = components, *const y = x + count, *const z = y + count;
  int i = 0;
  for (; i + lane_count <= count; i += lane_count, to += 4 * lane_count) {
    auto const cells = interleaved(load<Lanes>(x + i), load<Lanes>(y + i), load<Lanes>(z + i));
    for (std::size_t n = 0; n < cells.size(); ++n) {
      Real* const at = to + lane_count * n;
      store(at, load<Lanes>(at) + cells[n]);
    }
  }
  for (; i < count; ++i, to += 4) store(to, load<Cell>(to) + Cell{x[i], y[i], z[i], 0});
}

}  // namespace

Compensator::Compensator(Compensation const& compensation, ParticleMesh& mesh, RemoteBricks const& remote, bool matched)
    : compensation_(compensation),
      hierarchy_(mesh.hierarchy()),
      places_(mesh.density_places(matched)),
      plan_(remote.plan(matched, reach)),
      remote_(plan_.read(*compensation.density)) {
  for (int l = 0; l < hierarchy_.level_count(); ++l) {
    Halo const& halo = places_.halo(l);
    halos_.emplace_back(std::size_t(halo.size()));
    halo.update({compensation.density->level(l).data()}, {halos_.back().data()});
  }
}

void Compensator::reset(Box const& tile) {
  cells_ = tile.grow(reach);
  values_.resize(std::max(values_.size(), std::size_t(cells_.cells())));
  row_.resize(std::max(row_.size(), std::size_t(3 * cells_.extent(0))));
}

void Compensator::begin(std::size_t slot) {
  box_ = &places_.ghosts(slot);
  reset(hierarchy_.level(box_->level).box(box_->box));
  filled_ = cells_.lower[2] - 1;
}

void Compensator::add_to_slab(Box const& slab, bool precedes, Tile<per_cell>& tile) {
  for (int k = std::max(filled_ + 1, slab.lower[2] - reach); k <= slab.upper[2] + reach; ++k) fill_plane(k);
  filled_ = slab.upper[2] + reach;
  add(box_->level, slab.lower[2] - tile_reach + (precedes ? 2 * tile_reach : 0), slab.upper[2] + tile_reach, tile);
}

/// Bring the density in a plane of the box's cells and ghost cells into `values_`.
void Compensator::fill_plane(int k) {
  Level const& level = hierarchy_.level(box_->level);
  Box const& box = level.box(box_->box);
  box_->ghosts.for_each_run(k, [&](GhostRun const& run) {
    Real* out = values_.data() + cells_.offset(run.first);
    std::ptrdiff_t const stride = cells_.stride(run.axis);
    for (LocalIndex n = 0; n < run.count; ++n, out += stride)
      *out = run.place >= 0
                 ? at(box_->level, run.place + n * run.place_stride)
                 : interpolated(level.fold_at_walls(run.cell(n)), hierarchy_.level(box_->level - 1),
                                [&](Index3 const& from) -> Real const* {
                                  LocalIndex const place = box_->coarse[std::size_t(box_->parents.offset(from))];
                                  return place < 0 ? nullptr : &at(box_->level - 1, place);
                                });
  });
  if (k < box.lower[2] || k > box.upper[2]) return;
  Real const* from = compensation_.density->level(box_->level).data() + level.local_offset(box_->box) +
                     box.offset({box.lower[0], box.lower[1], k});
  for (int j = box.lower[1]; j <= box.upper[1]; ++j, from += box.extent(0))
    std::copy_n(from, box.extent(0), values_.data() + cells_.offset({box.lower[0], j, k}));
}

void Compensator::add_to_coarse(std::size_t slot, std::size_t r, CoarseCells const& coarse, Tile<per_cell>& tile) {
  reset(coarse.box);
  Real* out = values_.data();
  for (LocalIndex place : places_.matched(slot)[r - 1]) *out++ = place < 0 ? 0 : at(coarse.level, place);
  add(coarse.level, coarse.box.lower[2] - tile_reach, coarse.box.upper[2] + tile_reach, tile);
}

void Compensator::add_to_remote(std::size_t brick, std::size_t w, Tile<per_cell>& tile) {
  std::vector<Window> const& windows = plan_.bricks()[brick].windows;
  Window const& window = windows[w];
  Level const& level = hierarchy_.level(window.level);
  auto const value = [&](std::size_t n, Index3 const& cell) {
    return remote_.data() + plan_.first(brick, n) + windows[n].cells.offset(cell);
  };
  cells_ = window.cells;
  values_.assign(value(w, cells_.lower), value(w, cells_.lower) + cells_.cells());
  row_.resize(std::max(row_.size(), std::size_t(3 * cells_.extent(0))));
  if (!window.whole && w + 1 < windows.size()) {
    auto const coarse = [&](Index3 const& from) -> Real const* {
      for (Window::Part const& part : windows[w + 1].parts)
        if (part.cells.contains(from)) return value(w + 1, from);
      return nullptr;
    };
    for_each_missing(level, window, [&](Index3 const& cell) {
      values_[std::size_t(cells_.offset(cell))] = interpolated(cell, hierarchy_.level(window.level - 1), coarse);
    });
  }
  for_each_cell(cells_, [&](Index3 const& cell) {
    Index3 const from = level.fold_at_walls(cell);
    if (from != cell) values_[std::size_t(cells_.offset(cell))] = values_[std::size_t(cells_.offset(from))];
  });
  add(window.level, tile.cells().lower[2], tile.cells().upper[2], tile);
}

/// Add to planes [first, last] of a tile. A cell behind a wall has what the wall cell has.
void Compensator::add(int l, int first, int last, Tile<per_cell>& tile) {
  Level const& level = hierarchy_.level(l);
  Box const& all = tile.cells();
  Box const inside = level.cut_at_walls(all);
  int const count = inside.extent(0);
  for (int k = first; k <= last; ++k)
    for (int j = all.lower[1]; j <= all.upper[1]; ++j) {
      Index3 const from = level.fold_at_walls({inside.lower[0], j, k});
      write_differences(values_.data() + cells_.offset(from), cells_.stride(1), cells_.stride(2),
                        compensation_.factor[std::size_t(l)], count, row_.data());
      add_to_cells(row_.data(), count, tile.row(inside.lower[0], j, k));
      for (int i : {all.lower[0], all.upper[0]}) {
        if (i >= inside.lower[0] && i <= inside.upper[0]) continue;
        Real const* const end = row_.data() + (i < inside.lower[0] ? 0 : count - 1);
        Real* const out = tile.row(i, j, k);
        store(out, load<Cell>(out) + Cell{end[0], end[count], end[2 * count], 0});
      }
    }
}

}  // namespace amrpic
