// The field at particles, a group of eight at a time: read by gather and by push.
#pragma once

#include <algorithm>
#include <array>
#include <optional>
#include <type_traits>
#include <vector>

#include "base/fetch.hpp"
#include "mesh/electric_field.hpp"
#include "particle/clouds.hpp"
#include "particle/compensator.hpp"
#include "particle/difference_rows.hpp"
#include "particle/particle_mesh.hpp"
#include "particle/remote_bricks.hpp"
#include "particle/tile.hpp"
#include "particle/tile_batch.hpp"
#include "particle/view.hpp"

namespace amrpic {

constexpr int components = ElectricField::components_per_cell;  ///< numbers per boundary cell

/// The field in the boundary cells of a level: own ones, and those of other ranks.
struct BoundaryField {
  Real const* own;
  std::vector<Real> halo;
  LocalIndex owned;

  Real const* at(LocalIndex place) const {
    return place < owned ? own + std::ptrdiff_t(components) * place
                         : halo.data() + std::ptrdiff_t(components) * (place - owned);
  }
  /// Ask for `count` of them to be brought near.
  void bring_near(LocalIndex place, LocalIndex count) const {
    constexpr int line = 8;
    for (LocalIndex n = 0; n < components * count; n += line) amrpic::bring_near(at(place) + n);
  }
  /// Write `count` of them, `stride` cells apart, to places `out_stride` numbers apart.
  void write(LocalIndex place, std::ptrdiff_t stride, LocalIndex count, Real* out, std::ptrdiff_t out_stride) const {
    Real const* from = at(place);
    for (LocalIndex n = 0; n < count; ++n, from += components * stride, out += out_stride) store(out, load<Cell>(from));
  }
};

inline BoundaryField with_halo(ElectricField const& field, int level, Halo const& halo) {
  BoundaryField out{field.at_boundary(level), std::vector<Real>(components * std::size_t(halo.size()) + 1),
                    halo.owned()};
  std::vector<Real const*> own;
  std::vector<Real*> copies;
  for (int c = 0; c < 3; ++c) {
    own.push_back(out.own + c);
    copies.push_back(out.halo.data() + c);
  }
  halo.update(own, copies, components);
  return out;
}

inline void interleave_row(std::array<Real const*, 3> const& from, int count, Real* out) {
  int n = 0;
  for (; n + lane_count <= count; n += lane_count)
    interleave(load<Lanes>(from[0] + n), load<Lanes>(from[1] + n), load<Lanes>(from[2] + n), out + lanes * n);
  for (; n < count; ++n) store(out + lanes * n, Cell{from[0][n], from[1][n], from[2][n], 0});
}

/// Trilinear value of the coarser level, whose values are at(its cell), at the centre of `cell`, which lies inside the
/// domain.
template <class At>
void interpolate(Index3 const& cell, Level const& coarser, At const& at, Real* out) {
  for (int c = 0; c < 3; ++c) out[c] = 0;
  for_each_coarse_around(cell, [&](Index3 const& from, Real weight) {
    Real const* const value = at(coarser.fold_at_walls(from));
    for (int c = 0; c < 3; ++c) out[c] += weight * value[c];
  });
}

/// Brings the field of one box and its ghost cells into tiles of its slabs, plane by plane.
class Filler {
 public:
  /// `fields`: in the boundary cells, level by level; `rows`: where the box holds particles.
  Filler(ElectricField const& field, BoxGhosts const& at, BoundaryPlaces::GhostPlaces const& ghosts,
         std::vector<BoundaryField> const& fields, OccupiedRows const& rows)
      : field_(field),
        at_(at),
        ghosts_(ghosts),
        near_(rows, tile_reach),
        level_(field.hierarchy().level(at.level)),
        coarser_(field.hierarchy().level(std::max(0, at.level - 1))),
        box_(level_.box(at.box)),
        boundary_(fields[at.level]),
        coarse_(fields[std::max(0, at.level - 1)]),
        has_inner_rows_(field.potential() && !field.boundary(at.level).is_whole(at.box - level_.first_local_box())) {}

  /// Let the tiles of the box, which has this slot, be compensated.
  void compensate(std::size_t slot, Compensator& compensator, OccupiedRows const& rows) {
    compensator_ = &compensator;
    compensator.begin(slot, rows, has_inner_rows_);
  }

  /// Fill the tile of a slab. The tile may be that of the slab before, if that one `precedes`.
  void fill(Box const& slab, bool precedes, Tile<lanes>& tile) {
    int k = slab.lower[2] - tile_reach;
    if (precedes) {
      tile.follow(slab);
      k += 2 * tile_reach;
    } else {
      tile.reset(slab);
    }
    for (; k <= slab.upper[2] + tile_reach; ++k) {
      fill_plane(k, tile);
      if (compensator_) compensator_->add_to_plane(k, tile);
    }
  }

 private:
  void fill_plane(int k, Tile<lanes>& tile) {
    bring_boundary_near(k + 1);
    near_.go_to_plane(k);
    ghosts_.cells.for_each_run(k, [&](GhostRun const& run) {
      Real* const out = tile.row(run.first[0], run.first[1], k);
      std::ptrdiff_t const stride = run.axis == 0 ? lanes : tile.stride_y();
      if (run.place >= 0) return boundary_.write(run.place, run.place_stride, run.count, out, stride);
      for (LocalIndex n = 0; n < run.count; ++n)
        if (is_near(run.cell(n)))
          interpolate(
              level_.fold_at_walls(run.cell(n)), coarser_,
              [&](Index3 const& from) { return coarse_.at(ghosts_.coarse[std::size_t(at_.parents.offset(from))]); },
              out + n * stride);
    });
    if (k < box_.lower[2] || k > box_.upper[2]) return;
    if (field_.potential())
      fill_by_potential(k, tile);
    else
      fill_by_components(k, tile);
  }

  /// Whether clouds of particles may touch a cell. What is interpolated elsewhere would be for nothing.
  bool is_near(Index3 const& cell) const {
    RowPart const& part = near_(cell[1]);
    return cell[0] >= part.first && cell[0] <= part.last;
  }

  /// The ones of plane k: rows and columns here and there in memory, which processors do not foresee.
  void bring_boundary_near(int k) const {
    if (k > box_.upper[2] + tile_reach) return;
    ghosts_.cells.for_each_run(k, [&](GhostRun const& run) {
      if (run.place >= 0 && run.place_stride == 1) boundary_.bring_near(run.place, run.count);
    });
    if (field_.potential() && k >= box_.lower[2] && k <= box_.upper[2])
      for_each_own_run(k, [&](BoundaryCells::CellRun const& run) { boundary_.bring_near(run.number, run.count); });
  }

  /// Call f(run) for the boundary cells of the box in plane k.
  template <class F>
  void for_each_own_run(int k, F&& f) const {
    field_.boundary(at_.level).for_each_run(at_.box - level_.first_local_box(), k - box_.lower[2], f);
  }

  /// The box's own cells in plane k: the inner ones first, with what rows leave at their ends.
  void fill_by_potential(int k, Tile<lanes>& tile) const {
    if (has_inner_rows_ && k > box_.lower[2] && k < box_.upper[2])
      for (int j = box_.lower[1] + 1; j < box_.upper[1]; ++j) fill_inner_row(j, k, tile.row(box_.lower[0], j, k));
    for_each_own_run(k, [&](BoundaryCells::CellRun const& run) {
      Real* const out = tile.row(box_.lower[0] + run.i, box_.lower[1] + run.j, k);
      boundary_.write(run.number, 1, run.count, out, run.axis == 0 ? lanes : tile.stride_y());
    });
  }

  void fill_inner_row(int j, int k, Real* out) const {
    std::ptrdiff_t const y = box_.stride(1), z = box_.stride(2), row = box_.offset({box_.lower[0], j, k});
    int const count = box_.extent(0);
    DifferenceRow const phi{field_.potential()->level(at_.level).data() + level_.local_offset(at_.box) + row,
                            field_.factor(at_.level)};
    phi.bring_next_near(z, count);
    if (!compensator_ || near_(j).empty())
      return write_row([&](auto const&... of) { return phi.between(of...); }, y, z, count, out);
    compensator_->write_row(phi, row, y, z, count, out);
  }

  void fill_by_components(int k, Tile<lanes>& tile) const {
    std::array<Real const*, 3> from;
    for (int c = 0; c < 3; ++c)
      from[c] = field_.component(c).level(at_.level).data() + level_.local_offset(at_.box) +
                box_.offset({box_.lower[0], box_.lower[1], k});
    for (int j = box_.lower[1]; j <= box_.upper[1]; ++j) {
      interleave_row(from, box_.extent(0), tile.row(box_.lower[0], j, k));
      for (Real const*& row : from) row += box_.extent(0);
    }
  }

  ElectricField const& field_;
  BoxGhosts const& at_;
  BoundaryPlaces::GhostPlaces const& ghosts_;
  NearRows near_;
  Level const &level_, &coarser_;
  Box box_;
  BoundaryField const &boundary_, &coarse_;
  Compensator* compensator_ = nullptr;
  bool has_inner_rows_;  ///< whose field is the difference of the potential
};

inline void fill_coarse(std::vector<LocalIndex> const& places, BoundaryField const& field, Tile<lanes>& tile) {
  Real* value = tile.values();
  for (LocalIndex place : places) {
    if (place >= 0) store(value, load<Cell>(field.at(place)));
    value += lanes;
  }
}

/// Where in a tile the clouds of a block start, and their weights: along x, and the products of those along y and z.
template <int width>
struct CloudBlock {
  alignas(64) LocalIndex corner[block_size];
  alignas(64) Real row_weight[width * width][block_size];
  alignas(64) Real x_weight[width][block_size];
};

/// The tile averaged over clouds in y and z: the first two cells along x, side by side, and the third one.
struct Averages {
  Lanes pair;
  Cell last;
};

/// Those of particle i of a block.
template <int width>
inline Averages average(Real const* origin, std::ptrdiff_t stride_y, std::ptrdiff_t stride_z,
                        CloudBlock<width> const& clouds, int i) {
  Real const* const corner = origin + clouds.corner[i];
  Averages out;
  for (int k = 0; k < width; ++k)
    for (int j = 0; j < width; ++j) {
      Real const* const row = corner + j * stride_y + k * stride_z;
      Real const weight = clouds.row_weight[width * k + j][i];
      bool const first = k == 0 && j == 0;
      if constexpr (width > 1) out.pair = first ? weight * load<Lanes>(row) : out.pair + weight * load<Lanes>(row);
      Real const* const end = row + lanes * (width - 1);
      if constexpr (width % 2) out.last = first ? weight * load<Cell>(end) : out.last + weight * load<Cell>(end);
    }
  return out;
}

typedef std::array<Lanes, 3> Components;  ///< of the field at eight particles

/// The components of eight third cells.
inline Components last_cells(std::array<Averages, lane_count> const& of) {
  std::array<Lanes, 4> pair;
  for (std::size_t p = 0; p < 4; ++p) pair[p] = joined(of[2 * p].last, of[2 * p + 1].last);
  return separated(pair);
}

/// The components of eight first cells, and of the second ones.
inline std::array<Components, 2> pairs_of_cells(std::array<Averages, lane_count> const& of) {
  std::array<Lanes, lane_count> pair;
  for (std::size_t i = 0; i < lane_count; ++i) pair[i] = of[i].pair;
  return separated_halves(pair);
}

/// The averages of eight particles, averaged in x too.
template <int width>
inline Components average_in_x(std::array<Averages, lane_count> const& of, std::array<Lanes, width> const& weight) {
  Components out;
  if constexpr (width > 1) {
    auto const cells = pairs_of_cells(of);
    for (int d = 0; d < 3; ++d) {
      out[d] = weight[0] * cells[0][d];  // by itself, so that compilers agree which product they add without rounding
      out[d] += weight[1] * cells[1][d];
    }
  }
  if constexpr (width == 1) out = last_cells(of);
  if constexpr (width == 3) {
    auto const cells = last_cells(of);
    for (int d = 0; d < 3; ++d) out[d] += weight[2] * cells[d];
  }
  return out;
}

inline std::size_t number_in_block(LaneBlock const& block, LaneGroup const& group) {
  return std::size_t(group.first - block.first) / lane_count;
}

/// Call use(group, field) for particles with the tile averaged over their clouds; or use(block), and then what it
/// returns for the groups of that block. Nothing between the field and its use is stored: processors work on one while
/// they wait for the other.
template <class Shape, class Use>
void read_clouds(TileFrame const& frame, ParticleView const& particles, Chosen const& chosen, Tile<lanes> const& tile,
                 Use const& use) {
  constexpr int width = Shape::width;
  std::ptrdiff_t const stride_y = tile.stride_y(), stride_z = tile.stride_z();
  Real const* const origin = tile.values() + tile.box_corner();
  Real const row_step = Real(stride_y), plane_step = Real(stride_z);
  WideLanes all_in = WideLanes{} - 1;
  chosen.for_each_block([=, &particles, &all_in](LaneBlock const& block) {
    CloudBlock<width> clouds;
    bring_block_near(block.first + page<Real>, particles.position);
    bring_block_near(block.first + page<Real>, particles.momentum);
    WideLanes in = WideLanes{} - 1;
    for_each_group(block, [=, &particles, &clouds, &in](LaneGroup const& group) {
      int const i = int(group.first - block.first);
      auto const s = frame.inside(particles, group, in);
      auto const x = Shape::at(s[0]), y = Shape::at(s[1]), z = Shape::at(s[2]);
      store(clouds.corner + i, to_index(lanes * x.first + row_step * y.first + plane_step * z.first));
      for (int k = 0; k < width; ++k)
        for (int j = 0; j < width; ++j) store(clouds.row_weight[width * k + j] + i, z.weight[k] * y.weight[j]);
      for (int j = 0; j < width; ++j) store(clouds.x_weight[j] + i, x.weight[j]);
    });
    all_in &= in;
    auto const read_groups = [=, &clouds](auto const& use_group) {
      for_each_group(block, [=, &clouds, &use_group](LaneGroup const& group) {
        int const start = int(group.first - block.first);
        std::array<Averages, lane_count> averages;
#pragma GCC unroll 8
        for (int i = 0; i < lane_count; ++i) averages[i] = average(origin, stride_y, stride_z, clouds, start + i);
        std::array<Lanes, width> x_weight;
        for (int j = 0; j < width; ++j) x_weight[j] = load<Lanes>(clouds.x_weight[j] + start);
        use_group(group, average_in_x<width>(averages, x_weight));
      });
    };
    if constexpr (std::is_invocable_v<Use, LaneBlock const&>)
      read_groups(use(block));
    else
      read_groups(use);
  });
  frame.require_inside(all_in, particles, chosen);
}

/// The field in the regions of remote bricks.
class RemoteField {
 public:
  /// Collective.
  RemoteField(ElectricField const& field, RemotePlan const& plan)
      : hierarchy_(field.hierarchy()), plan_(plan), values_(plan.read(field)) {}

  /// Bring a region into a tile on the same cells.
  void fill(std::size_t brick, std::size_t w, Tile<lanes>& tile) const {
    std::vector<Region> const& regions = plan_.bricks()[brick].regions;
    Region const& region = regions[w];
    Level const& level = hierarchy_.level(region.level);
    Real const* value = at(brick, w, region.cells.lower);
    for_each_row(region.cells, [&](Index3 const& first) {
      Real* out = tile.row(first[0], first[1], first[2]);
      for (int n = 0; n < region.cells.extent(0); ++n, value += components, out += lanes)
        store(out, Cell{value[0], value[1], value[2], 0});
    });
    if (!region.whole && w + 1 < regions.size())
      for_each_missing(level, region, [&](Index3 const& cell) {
        interpolate(
            cell, hierarchy_.level(region.level - 1), [&](Index3 const& from) { return at(brick, w + 1, from); },
            tile.row(cell[0], cell[1], cell[2]));
      });
    if (Box const inside = level.cut_at_walls(region.cells); !(inside == region.cells))
      for_each_cell(region.cells, [&](Index3 const& cell) {
        Index3 const from = level.fold_at_walls(cell);
        if (from != cell) store(tile.row(cell[0], cell[1], cell[2]), load<Cell>(tile.row(from[0], from[1], from[2])));
      });
  }

 private:
  Real const* at(std::size_t brick, std::size_t w, Index3 const& cell) const {
    Box const& cells = plan_.bricks()[brick].regions[w].cells;
    return values_.data() + components * (plan_.first(brick, w) + std::size_t(cells.offset(cell)));
  }

  Hierarchy const& hierarchy_;
  RemotePlan const& plan_;
  std::vector<Real> values_;
};

/// Averages tiles over clouds slab by slab, by vectors; `use` as in `read_clouds`.
template <class Use>
class SlabReader {
 public:
  SlabReader(ParticleMesh const& mesh, Shape shape, ParticleView const& particles, Use const& use)
      : mesh_(mesh),
        shape_(shape),
        particles_(particles),
        use_(use),
        tiles_(std::size_t(mesh.hierarchy().level_count())) {}
  std::vector<Tile<lanes>>& tiles() { return tiles_; }
  int planes(Box const& box) const { return planes_per_slab(box, lanes); }
  void read(int level, Box const& slab, BoxBuffer const* buffer, std::int64_t from, std::int64_t to) {
    for_each_coarsening_depth(mesh_, level, slab, buffer, particles_, from, to,
                              [&](int depth, TileFrame const& frame, Chosen const& chosen) {
                                with_shape(shape_, [&](auto s) {
                                  read_clouds<decltype(s)>(frame, particles_, chosen, tiles_[std::size_t(depth)], use_);
                                });
                              });
  }
  void finish() {}

 private:
  ParticleMesh const& mesh_;
  Shape shape_;
  ParticleView const& particles_;
  Use const& use_;
  std::vector<Tile<lanes>> tiles_;  ///< by how much coarser than their box
};

/// Leaves that to portable kernels, box by box.
class PortableReader : TileBatch<Tile<lanes>, lanes> {
 public:
  using TileBatch::TileBatch;
  std::vector<Tile<lanes>>& tiles() { return next(); }
  int planes(Box const& box) const { return box.extent(2); }
  void read(int level, Box const& box, BoxBuffer const* buffer, std::int64_t first, std::int64_t last) {
    add(level, box, buffer, first, last);
  }
  void finish() { run(); }
};

/// Bring the field into tiles for all particles of this rank, and let them be read. Collective.
template <class Reader>
void read_tiles(ParticleMesh& mesh, RemoteBricks const& remote, bool matched, ElectricField const& field,
                ParticleView const& particles, std::int64_t const* starts, Reader&& reader) {
  Hierarchy const& hierarchy = mesh.hierarchy();
  BufferZone const* const zone = matched ? &mesh.buffer_zone() : nullptr;
  BoundaryPlaces const& places = mesh.boundary_places(matched);
  std::vector<BoundaryField> own, coarse;
  for (int l = 0; l < hierarchy.level_count(); ++l) {
    own.push_back(with_halo(field, l, places.halo(l)));
    if (zone) coarse.push_back(with_halo(field, l, places.halo_of_matched(l)));
  }

  RemotePlan const& plan = remote.plan(matched);
  RemoteField const remote_field(field, plan);
  std::optional<Compensator> compensator;
  if (field.compensation().density) compensator.emplace(field.compensation(), mesh, remote, matched);

  auto const read_box = [&](std::size_t slot, std::int64_t first, std::int64_t last) {
    BoxGhosts const& at = mesh.boxes()[slot];
    BoxBuffer const* const buffer = zone ? zone->box(slot) : nullptr;
    std::vector<Tile<lanes>>& tiles = reader.tiles();
    for (std::size_t r = 1; buffer && r <= buffer->coarse.size(); ++r) {
      CoarseCells const& c = buffer->coarse[r - 1];
      tiles[r].reset(c.box);
      fill_coarse(places.ghosts(slot).matched[r - 1], coarse[c.level], tiles[r]);
      if (compensator) compensator->add_to_coarse(slot, r, c, tiles[r]);
    }
    Box const& box = hierarchy.level(at.level).box(at.box);
    // To search for the bricks with particles takes time, so it is left out where little depends on it.
    bool const interpolates = !places.ghosts(slot).coarse.empty(), is_crowded = last - first > box.cells();
    OccupiedRows const rows = interpolates || (compensator && !is_crowded)
                                  ? OccupiedRows(box, mesh.locator().coordinates(at.level), particles, first, last)
                                  : OccupiedRows(box);
    Filler filler(field, at, places.ghosts(slot), own, rows);
    if (compensator) filler.compensate(slot, *compensator, rows);
    bool precedes = false;  // whether tiles[0] is that of the slab before
    for_each_slab(mesh, at.level, box, reader.planes(box), particles, first, last,
                  [&](Box const& slab, auto from, auto to) {
                    if (from < to) filler.fill(slab, precedes, tiles[0]);
                    precedes = from < to;
                    reader.read(at.level, slab, buffer, from, to);
                  });
  };
  auto const read_remote = [&](std::size_t n, std::int64_t first, std::int64_t last) {
    BrickRegions const& brick = plan.bricks()[n];
    std::vector<Tile<lanes>>& tiles = reader.tiles();
    tiles[0].reset(brick.cells);
    remote_field.fill(n, 0, tiles[0]);
    if (compensator) compensator->add_to_remote(n, 0, tiles[0]);
    for (std::size_t r = 1; r <= brick.buffer.coarse.size(); ++r) {
      tiles[r].reset(brick.buffer.coarse[r - 1].box);
      remote_field.fill(n, r, tiles[r]);
      if (compensator) compensator->add_to_remote(n, r, tiles[r]);
    }
    reader.read(brick.home.level, brick.cells, brick.buffer.coarse.empty() ? nullptr : &brick.buffer, first, last);
  };
  for_each_occupied(mesh, remote.bricks().size(), starts, read_box, read_remote, [&] { reader.finish(); });
}

/// Call use(group, field) for all particles of this rank, or as `read_clouds` has it. Collective.
template <class Use>
void read_field(ParticleMesh& mesh, RemoteBricks const& remote, Clouds const& clouds, ElectricField const& field,
                ParticleView const& particles, std::int64_t const* starts, Use const& use) {
  read_tiles(mesh, remote, clouds.matched, field, particles, starts, SlabReader(mesh, clouds.shape, particles, use));
}

}  // namespace amrpic
