#include "particle/compensator.hpp"

#include <algorithm>

#include "stencil/field_difference.hpp"

namespace amrpic {

namespace {

constexpr int reach = DensityPlaces::reach;
constexpr int ahead = 2;  ///< planes for which memory is asked before they are filled
typedef Real Pair __attribute__((vector_size(16)));

/// Of two cells of a tile, from their components.
Lanes two_cells(Pair const& x, Pair const& y, Pair const& z) {
  Pair const zero{};
  auto const one = [](Pair const& xy, Pair const& z0) { return __builtin_shufflevector(xy, z0, 0, 1, 2, 3); };
  return joined(one(__builtin_shufflevector(x, y, 0, 2), __builtin_shufflevector(z, zero, 0, 2)),
                one(__builtin_shufflevector(x, y, 1, 3), __builtin_shufflevector(z, zero, 1, 3)));
}

/// Trilinear value at the centre of `cell`, which lies inside the domain, of a coarser level's density: at(its cell),
/// or null where that level has none; there the parent's value serves.
template <class At>
Real interpolated(Index3 const& cell, Level const& coarser, At const& at) {
  Real const of_parent = *at(coarser.fold_at_walls(parent_of(cell)));
  Real out = 0;
  for_each_coarse_around(cell, [&](Index3 const& from, Real weight) {
    Real const* const value = at(coarser.fold_at_walls(from));
    out += weight * (value ? *value : of_parent);
  });
  return out;
}

/// The same of a cell on one side along x of parent p, from four rows of parents: its own, those of its neighbours
/// along y, along z, and along both.
template <class At>
auto between_rows(std::array<Real const*, 4> const& rows, int p, int side, At const& at) {
  constexpr Real near = prolongation::near, far = prolongation::far;
  constexpr Real weight[4] = {near * near, far * near, near * far, far * far};
  auto out = near * weight[0] * at(rows[0] + p);
  for (std::size_t n = 0; n < 4; ++n) {
    if (n > 0) out += near * weight[n] * at(rows[n] + p);
    out += far * weight[n] * at(rows[n] + p + side);
  }
  return out;
}

/// Copy a row, by vectors of which the last one may overlap the one before.
void copy_row(Real const* from, int count, Real* to) {
  if (count < lane_count) {
    for (int i = 0; i < count; ++i) to[i] = from[i];
    return;
  }
  int const last = count - lane_count;
  for (int i = 0; i < last; i += lane_count) store(to + i, load<Lanes>(from + i));
  store(to + last, load<Lanes>(from + last));
}

void bring_row_near(Real const* from, int count) {
  constexpr int line = 64 / sizeof(Real);
  for (int i = 0; i < count; i += line) bring_near(from + i);
}

/// A density in a row of cells, and in those below and above along z; it follows along y.
struct DensityRow {
  Real const *values, *below, *above;
  std::ptrdiff_t y;

  DensityRow from(std::ptrdiff_t i) const { return {values + i, below + i, above + i, y}; }
  template <class Vector>
  std::array<Vector, 3> differences(Real3 const& factor, int i) const {
    auto const at = [](Real const* from) { return load<Vector>(from); };
    return {field_between(factor[0], at(values + i - 1), at(values + i + 1)),
            field_between(factor[1], at(values + i - y), at(values + i + y)),
            field_between(factor[2], at(below + i), at(above + i))};
  }
};

inline void add_to_two(DensityRow const& density, Real3 const& factor, int i, Real* to) {
  auto const [x, y, z] = density.differences<Pair>(factor, i);
  store(to, load<Lanes>(to) + two_cells(x, y, z));
}

/// Add the differences of a density across the cells of a row to the tile's cells.
void add_differences(DensityRow const& density, Real3 const& factor, int count, Real* to) {
  int i = 0;
  for (; i + lane_count <= count; i += lane_count) {
    auto const [x, y, z] = density.differences<Lanes>(factor, i);
    auto const cells = interleaved(x, y, z);
    for (std::size_t n = 0; n < cells.size(); ++n, to += lane_count) store(to, load<Lanes>(to) + cells[n]);
  }
  for (; i + 2 <= count; i += 2, to += 2 * Compensator::per_cell) add_to_two(density, factor, i, to);
  for (; i < count; ++i, to += Compensator::per_cell) {
    auto const [x, y, z] = density.differences<Real>(factor, i);
    store(to, load<Cell>(to) + Cell{x, y, z, 0});
  }
}

/// The same in the first two cells of many rows.
void add_to_columns(DensityRow density, Real3 const& factor, int rows, Real* to, std::ptrdiff_t stride) {
  for (; rows > 0; --rows, density = density.from(density.y), to += stride) add_to_two(density, factor, 0, to);
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

void Compensator::begin(int level, Box const& tile, OccupiedRows const& rows) {
  level_ = level;
  inside_ = Box{};
  cells_ = tile.grow(reach);
  near_tile_ = NearRows(rows, tile_reach);
  near_ = NearRows(rows, reach);
}

void Compensator::begin(std::size_t slot, OccupiedRows const& rows, bool others_add_inside) {
  box_ = &places_.box(slot);
  is_whole_ = places_.is_whole(slot);
  Box const& box = rows.box();
  begin(box_->level, box, rows);
  if (others_add_inside) inside_ = box.grow(-1);
  planes_ = planes_kept;
  values_.resize(std::max(values_.size(), std::size_t(cells_.stride(2) * planes_)));
  filled_ = cells_.lower[2] - 1;
  has_coarse_ = false;
  for (int k = cells_.lower[2]; k < cells_.lower[2] + ahead; ++k) bring_plane_near(k);
}

void Compensator::add_to_plane(int k, Tile<per_cell>& tile) {
  int const middle = hierarchy_.level(level_).fold_at_walls({0, 0, k})[2];
  for (int p = std::max(filled_ + 1, middle - 1); p <= middle + 1; ++p) fill_plane(p);
  filled_ = std::max(filled_, middle + 1);
  add(k, tile);
}

// In this file, which is compiled without fused multiply-adds, so that a cell's value does not depend on where in a box
// the cell lies.
void Compensator::write_row(DifferenceRow const& phi, std::ptrdiff_t row, std::ptrdiff_t y, std::ptrdiff_t z, int count,
                            Real* out) const {
  DifferenceRow const rho{own() + row, compensation_.factor[std::size_t(level_)]};
  amrpic::write_row([&](auto const&... of) { return phi.between(of...) + rho.between(of...); }, y, z, count, out);
}

/// Bring the density in a plane of the box's cells and ghost cells into `values_`, where particles are near.
void Compensator::fill_plane(int k) {
  near_.go_to_plane(k);
  fill_own_rows(k);
  box_->ghosts.for_each_run(k, [&](GhostRun const& run) { fill_run(run, k); });
  bring_plane_near(k + ahead);
}

/// Ask for what will be wanted of a plane: rows here and there in memory, which processors do not foresee.
void Compensator::bring_plane_near(int k) const {
  if (k > cells_.upper[2]) return;
  box_->ghosts.for_each_run(k, [&](GhostRun const& run) {
    if (run.place < 0) return;
    Real const* const from = &at(level_, run.place);
    if (run.place_stride == 1) return bring_row_near(from, run.count);
    for (LocalIndex n = 0; n < run.count; ++n) bring_near(from + n * run.place_stride);
  });
}

/// The box's own cells in a plane.
void Compensator::fill_own_rows(int k) {
  Box const& box = hierarchy_.level(level_).box(box_->box);
  if (k < box.lower[2] || k > box.upper[2]) return;
  Real const* row = own() + box.offset({box.lower[0], box.lower[1], k});
  int const count = box.extent(0), last = count - reach;
  for (int j = box.lower[1]; j <= box.upper[1]; ++j, row += count) {
    Real* const to = cell(box.lower[0], j, k);
    RowPart const part = near_(j).intersect(box.lower[0], box.upper[0]);
    int const first = part.first - box.lower[0];
    if (part.empty()) continue;
    if (is_inside(j - 1, k - 1) && is_inside(j + 1, k + 1) && last >= reach)  // the ends alone are wanted
      store(to, load<Pair>(row)), store(to + last, load<Pair>(row + last));
    else
      copy_row(row + first, part.last - part.first + 1, to + first);
  }
}

/// Ghost cells in a row or a column: the level's own, or values between coarser ones.
void Compensator::fill_run(GhostRun const& run, int k) {
  bool const is_missing = run.place < 0, is_row = run.axis == 0;
  if (is_missing && matched_) return;  // with matched clouds no particle reads what follows from there
  Real const* const from = is_missing ? nullptr : &at(level_, run.place);
  int const i = run.first[0], j = run.first[1], rows = is_row ? 1 : run.count;
  bool const is_pair = is_missing && !is_row && is_whole_;  // two columns of children of the same parents, at once
  if (is_pair && i % 2 != 0) return;
  int const last = i + (is_row ? run.count : is_pair ? 2 : 1) - 1;
  if (!is_row && !is_missing && near_.holds(i, i)) {  // columns: as many rows as in all else together
    Real* const to = cell(i, j, k);
    for (int n = 0; n < rows; ++n) to[n * cells_.stride(1)] = from[std::ptrdiff_t(n) * run.place_stride];
    return;
  }
  for (int n = 0; n < rows; ++n) {
    RowPart const part = near_(j + n).intersect(i, last);
    if (part.empty()) continue;
    Real* const to = cell(part.first, j + n, k);
    if (is_missing)
      interpolate_row(part, j + n, k, to);
    else
      copy_row(from + std::ptrdiff_t(n) * run.place_stride + (part.first - i), part.last - part.first + 1, to);
  }
}

void Compensator::interpolate_row(RowPart const& part, int j, int k, Real* out) {
  if (is_whole_) return interpolate_whole_row(part, j, k, out);
  Level const &level = hierarchy_.level(level_), &coarser = hierarchy_.level(level_ - 1);
  for (int i = part.first; i <= part.last; ++i)
    *out++ = interpolated(level.fold_at_walls({i, j, k}), coarser, [&](Index3 const& from) -> Real const* {
      LocalIndex const place = box_->coarse[std::size_t(box_->parents.offset(from))];
      return place < 0 ? nullptr : &at(level_ - 1, place);
    });
}

/// The coarser level's density on the parents of the box, as far as cells are interpolated from it.
void Compensator::read_coarse() {
  std::size_t const cells = box_->coarse.size();
  coarse_.resize(std::max(coarse_.size(), cells + lane_count));  // vectors may touch what follows
  for (std::size_t n = 0; n < cells; ++n)
    if (LocalIndex const place = box_->coarse[n]; place >= 0) coarse_[n] = at(level_ - 1, place);
  has_coarse_ = true;
}

/// The same values where all coarse ones exist: both children along x of several parents at a time.
void Compensator::interpolate_whole_row(RowPart const& part, int j, int k, Real* out) {
  if (!has_coarse_) read_coarse();
  Box const& parents = box_->parents;
  Index3 const near = parent_of({part.first, j, k}), far = nearest_other_parent({part.first, j, k});
  int const last = floor_divide(part.last, 2), skipped = part.first - 2 * near[0];
  std::array<Real const*, 4> rows;
  for (int n = 0; n < 4; ++n)
    rows[std::size_t(n)] =
        coarse_.data() + parents.offset({near[0], n & 1 ? far[1] : near[1], n & 2 ? far[2] : near[2]});
  row_.resize(std::max(row_.size(), std::size_t(2 * (last - near[0] + 1 + lane_count))));
  Real* to = row_.data();
  int const count = last - near[0] + 1;
  auto const eight = [](Real const* from) { return load<Lanes>(from); };
  int p = 0;
  for (; p + 2 < count; p += lane_count, to += 2 * lane_count) {
    auto const cells = interleaved(between_rows(rows, p, -1, eight), between_rows(rows, p, 1, eight));
    store(to, cells[0]);
    store(to + lane_count, cells[1]);
  }
  auto const one = [](Real const* from) { return *from; };
  for (; p < count; ++p, to += 2) to[0] = between_rows(rows, p, -1, one), to[1] = between_rows(rows, p, 1, one);
  copy_row(row_.data() + skipped, part.last - part.first + 1, out);
}

void Compensator::add_to_coarse(std::size_t slot, std::size_t r, CoarseCells const& coarse, Tile<per_cell>& tile) {
  OccupiedRows const rows(coarse.box);
  begin(coarse.level, coarse.box, rows);
  values_.resize(std::max(values_.size(), std::size_t(cells_.cells())));
  Real* out = values_.data();
  for (LocalIndex place : places_.matched(slot)[r - 1]) *out++ = place < 0 ? 0 : at(coarse.level, place);
  add_to_whole(tile);
}

void Compensator::add_to_remote(std::size_t brick, std::size_t w, Tile<per_cell>& tile) {
  std::vector<Region> const& regions = plan_.bricks()[brick].regions;
  Region const& region = regions[w];
  Level const& level = hierarchy_.level(region.level);
  auto const value = [&](std::size_t n, Index3 const& cell) {
    return remote_.data() + plan_.first(brick, n) + regions[n].cells.offset(cell);
  };
  OccupiedRows const rows(tile.cells().grow(-tile_reach));
  begin(region.level, rows.box(), rows);
  values_.assign(value(w, cells_.lower), value(w, cells_.lower) + cells_.cells());
  if (!region.whole && w + 1 < regions.size()) {
    auto const coarse = [&](Index3 const& from) -> Real const* {
      for (Overlap const& o : regions[w + 1].parts)
        if (o.part.contains(from)) return value(w + 1, from);
      return nullptr;
    };
    for_each_missing(level, region, [&](Index3 const& cell) {
      values_[std::size_t(cells_.offset(cell))] = interpolated(cell, hierarchy_.level(region.level - 1), coarse);
    });
  }
  for_each_cell(cells_, [&](Index3 const& cell) {
    Index3 const from = level.fold_at_walls(cell);
    if (from != cell) values_[std::size_t(cells_.offset(cell))] = values_[std::size_t(cells_.offset(from))];
  });
  add_to_whole(tile);
}

/// All planes of a tile, the density of which is kept whole.
void Compensator::add_to_whole(Tile<per_cell>& tile) {
  planes_ = cells_.extent(2);
  for (int k = tile.cells().lower[2]; k <= tile.cells().upper[2]; ++k) add(k, tile);
}

/// Add to plane k of a tile, where particles are near. A cell behind a wall has what the wall cell has.
void Compensator::add(int k, Tile<per_cell>& tile) {
  Level const& level = hierarchy_.level(level_);
  Real3 const& factor = compensation_.factor[std::size_t(level_)];
  Box const& all = tile.cells();
  Box const inside = level.cut_at_walls(all);
  int const middle = std::max(inside.lower[2], std::min(inside.upper[2], k));
  Real const *const density = plane(middle), *const below = plane(middle - 1), *const above = plane(middle + 1);
  auto const density_in = [&](int i, int j) {
    std::ptrdiff_t const at = (j - cells_.lower[1]) * cells_.stride(1) + (i - cells_.lower[0]);
    return DensityRow{density, below, above, cells_.stride(1)}.from(at);
  };
  near_tile_.go_to_plane(k);
  Box columns = inside_;  // rows in which the two cells at each end alone are wanted
  if (!near_tile_.holds(all.lower[0], all.upper[0]) || !(inside == all) || k < inside_.lower[2] || k > inside_.upper[2])
    columns = Box{};
  if (!columns.empty())
    for (int i : {all.lower[0], inside_.upper[0] + 1})
      add_to_columns(density_in(i, columns.lower[1]), factor, columns.extent(1), tile.row(i, columns.lower[1], k),
                     tile.stride_y());
  for (int j = all.lower[1]; j <= all.upper[1]; ++j) {
    if (!columns.empty() && j == columns.lower[1]) j = columns.upper[1] + 1;
    RowPart const& part = near_tile_(j);
    RowPart const own = part.intersect(inside.lower[0], inside.upper[0]);
    if (own.empty()) continue;
    int const from_j = std::max(inside.lower[1], std::min(inside.upper[1], j));
    auto const add_part = [&](int to, int from, int count) {
      if (count > 0) add_differences(density_in(from, from_j), factor, count, tile.row(to, j, k));
    };
    auto const add_own = [&](RowPart const& cells) {
      add_part(cells.first, cells.first, cells.last - cells.first + 1);
    };
    if (is_inside(j, k)) {
      add_own(own.intersect(all.lower[0], inside_.lower[0] - 1));
      add_own(own.intersect(inside_.upper[0] + 1, all.upper[0]));
    } else {
      add_own(own);
    }
    if (part.first < inside.lower[0]) add_part(all.lower[0], inside.lower[0], 1);
    if (part.last > inside.upper[0]) add_part(all.upper[0], inside.upper[0], 1);
  }
}

}  // namespace amrpic
