#include "particle/compensator.hpp"

#include <algorithm>

#include "base/lanes.hpp"
#include "stencil/field_difference.hpp"

namespace amrpic {

namespace {

constexpr int reach = DensityPlaces::reach;
typedef Real Cell __attribute__((vector_size(8 * Compensator::per_cell)));

/// Trilinear value at the centre of `cell`, which lies inside the domain, of a coarser level's density: at(its cell),
/// or null where that level has none; there the parent's value serves.
template <class At>
Real interpolated(Index3 const& cell, Level const& coarser, At const& at) {
  Real const of_parent = *at(coarser.fold_at_walls(cell_parent(cell)));
  Real out = 0;
  for_each_coarse_around(cell, [&](Index3 const& from, Real weight) {
    Real const* const value = at(coarser.fold_at_walls(from));
    out += weight * (value ? *value : of_parent);
  });
  return out;
}

/// Add the differences of a density across the cells of a row to the tile's cells.
void add_differences(Real const* density, std::ptrdiff_t y, std::ptrdiff_t z, Real3 const& factor, int count,
                     Real* to) {
  std::ptrdiff_t const step[3] = {1, y, z};
  auto const across = [&](auto const& at, int i, std::size_t d) {
    return field_between(factor[d], at(density + i - step[d]), at(density + i + step[d]));
  };
  auto const eight = [](Real const* from) { return load<Lanes>(from); };
  auto const one = [](Real const* from) { return *from; };
  int i = 0;
  for (; i + lane_count <= count; i += lane_count) {
    auto const cells = interleaved(across(eight, i, 0), across(eight, i, 1), across(eight, i, 2));
    for (std::size_t n = 0; n < cells.size(); ++n, to += lane_count) store(to, load<Lanes>(to) + cells[n]);
  }
  for (; i < count; ++i, to += Compensator::per_cell)
    store(to, load<Cell>(to) + Cell{across(one, i, 0), across(one, i, 1), across(one, i, 2), 0});
}

}  // namespace

Compensator::Compensator(Compensation const& compensation, ParticleMesh& mesh, RemoteBricks const& remote, bool matched)
    : compensation_(compensation),
      matched_(matched),
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
}

void Compensator::begin(std::size_t slot, OccupiedRows rows) {
  box_ = &places_.ghosts(slot);
  rows_ = std::move(rows);
  reset(hierarchy_.level(box_->level).box(box_->box));
  filled_ = cells_.lower[2] - 1;
}

void Compensator::add_to_slab(Box const& slab, bool precedes, Tile<per_cell>& tile) {
  for (int k = std::max(filled_ + 1, slab.lower[2] - reach); k <= slab.upper[2] + reach; ++k) fill_plane(k);
  filled_ = slab.upper[2] + reach;
  add(box_->level, rows_, slab.lower[2] - tile_reach + (precedes ? 2 * tile_reach : 0), slab.upper[2] + tile_reach,
      tile);
}

/// Bring the density in a plane of the box's cells and ghost cells into `values_`, where particles are near.
void Compensator::fill_plane(int k) {
  Level const& level = hierarchy_.level(box_->level);
  Box const& box = level.box(box_->box);
  near_.clear();
  for (int j = cells_.lower[1]; j <= cells_.upper[1]; ++j) near_.push_back(rows_.near(j, k, reach));
  box_->ghosts.for_each_run(k, [&](GhostRun const& run) { fill_run(run); });
  if (k < box.lower[2] || k > box.upper[2]) return;
  Real const* const own = compensation_.density->level(box_->level).data() + level.local_offset(box_->box);
  for (int j = box.lower[1]; j <= box.upper[1]; ++j) {
    RowPart const& part = near(j);
    int const first = std::max(part.first, box.lower[0]), last = std::min(part.last, box.upper[0]);
    if (first > last) continue;
    std::copy_n(own + box.offset({first, j, k}), last - first + 1, values_.data() + cells_.offset({first, j, k}));
  }
}

/// The same of a run of ghost cells, of which those near particles are wanted.
void Compensator::fill_run(GhostRun const& run) {
  Index3 const& at = run.first;
  LocalIndex first = 0, last = run.count - 1;
  if (run.axis == 0) {
    RowPart const& part = near(at[1]);
    if (part.first > part.last) return;
    first = std::max(part.first, at[0]) - at[0], last = std::min(part.last, at[0] + last) - at[0];
  }
  auto const is_near = [&](LocalIndex n) {
    return run.axis == 0 || (at[0] >= near(at[1] + n).first && at[0] <= near(at[1] + n).last);
  };
  Real* const out = values_.data() + cells_.offset(at);
  std::ptrdiff_t const stride = cells_.stride(run.axis);
  if (run.place < 0) {  // with matched clouds no particle reads what follows from there
    for (LocalIndex n = first; !matched_ && n <= last; ++n)
      if (is_near(n)) out[n * stride] = interpolated_at(run.cell(n));
    return;
  }
  Real const* const from = &this->at(box_->level, run.place);
  for (LocalIndex n = first; n <= last; ++n)
    if (is_near(n)) out[n * stride] = from[std::ptrdiff_t(n) * run.place_stride];
}

Real Compensator::interpolated_at(Index3 const& cell) const {
  int const coarser = box_->level - 1;
  return interpolated(hierarchy_.level(box_->level).fold_at_walls(cell), hierarchy_.level(coarser),
                      [&](Index3 const& from) -> Real const* {
                        LocalIndex const place = box_->coarse[std::size_t(box_->parents.offset(from))];
                        return place < 0 ? nullptr : &at(coarser, place);
                      });
}

void Compensator::add_to_coarse(std::size_t slot, std::size_t r, CoarseCells const& coarse, Tile<per_cell>& tile) {
  reset(coarse.box);
  Real* out = values_.data();
  for (LocalIndex place : places_.matched(slot)[r - 1]) *out++ = place < 0 ? 0 : at(coarse.level, place);
  add(coarse.level, OccupiedRows(coarse.box), coarse.box.lower[2] - tile_reach, coarse.box.upper[2] + tile_reach, tile);
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
  add(window.level, OccupiedRows(tile.cells().grow(-tile_reach)), tile.cells().lower[2], tile.cells().upper[2], tile);
}

/// Add to planes [first, last] of a tile, where particles are near. A cell behind a wall has what the wall cell has.
void Compensator::add(int l, OccupiedRows const& rows, int first, int last, Tile<per_cell>& tile) const {
  Level const& level = hierarchy_.level(l);
  Box const& all = tile.cells();
  Box const inside = level.cut_at_walls(all);
  auto const add_part = [&](Index3 const& to, int from_x, int count) {
    Index3 const from = level.fold_at_walls({from_x, to[1], to[2]});
    add_differences(values_.data() + cells_.offset(from), cells_.stride(1), cells_.stride(2),
                    compensation_.factor[std::size_t(l)], count, tile.row(to[0], to[1], to[2]));
  };
  for (int k = first; k <= last; ++k)
    for (int j = all.lower[1]; j <= all.upper[1]; ++j) {
      RowPart const part = rows.near(j, k, tile_reach);
      int const from = std::max(part.first, inside.lower[0]), to = std::min(part.last, inside.upper[0]);
      if (from > to) continue;
      add_part({from, j, k}, from, to - from + 1);
      for (int i : {all.lower[0], all.upper[0]})
        if ((i < inside.lower[0] || i > inside.upper[0]) && i >= part.first && i <= part.last)
          add_part({i, j, k}, i < inside.lower[0] ? inside.lower[0] : inside.upper[0], 1);
    }
}

}  // namespace amrpic
