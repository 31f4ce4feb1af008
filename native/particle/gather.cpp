#include "particle/gather.hpp"

#include "particle/tile.hpp"

namespace amrpic {

namespace {

/// Three components per cell and one of padding, so that a cell fills a vector register.
constexpr int lanes = 4;
typedef Real Cell __attribute__((vector_size(8 * lanes)));

/// The three components of a field on one level: own cells, and ghosts beyond them.
struct VectorCells {
  std::array<Real const*, 3> own;
  std::array<std::vector<Real>, 3> ghosts;
  LocalIndex owned;

  void get(LocalIndex place, Real* out) const {
    for (int c = 0; c < 3; ++c) out[c] = place < owned ? own[c][place] : ghosts[c][std::size_t(place - owned)];
  }
  void prefetch(LocalIndex place) const {
    for (int c = 0; c < 3; ++c) __builtin_prefetch(own[c] + place);  // harmless beyond the end
  }
};

VectorCells with_ghosts(std::array<Field const*, 3> const& field, int level, Exchange const& exchange) {
  VectorCells out;
  out.owned = exchange.owned();
  std::vector<Real const*> own;
  std::vector<Real*> ghosts;
  for (int c = 0; c < 3; ++c) {
    out.ghosts[c].resize(std::size_t(exchange.ghosts()));
    out.own[c] = field[c]->level(level).data();
    own.push_back(out.own[c]);
    ghosts.push_back(out.ghosts[c].data());
  }
  exchange.update(own, ghosts);
  return out;
}

/// Trilinear value of the coarser level at the centre of `cell`, which lies inside the domain.
void interpolate(Index3 const& cell, Surroundings const& at, Level const& coarser, VectorCells const& coarse,
                 Real* out) {
  Index3 const near = cell_parent(cell), far = nearest_other_parent(cell);
  for (int c = 0; c < 3; ++c) out[c] = 0;
  for (int corner = 0; corner < 8; ++corner) {
    Real weight = 1;  // the centre lies a quarter of a coarse cell from that of its parent, along each axis
    Index3 from;
    for (int d = 0; d < 3; ++d) {
      bool const is_far = (corner >> d) & 1;
      weight *= is_far ? Real(0.25) : Real(0.75);
      from[d] = is_far ? far[d] : near[d];
    }
    Real value[3];
    coarse.get(at.coarse[std::size_t(at.parents.offset(fold_at_walls(from, coarser)))], value);
    for (int c = 0; c < 3; ++c) out[c] += weight * value[c];
  }
}

/// Interleave three components of eight consecutive cells.
inline void interleave(Lanes const& x, Lanes const& y, Lanes const& z, Real* out) {
  Lanes const xy[2] = {__builtin_shufflevector(x, y, 0, 8, 1, 9, 2, 10, 3, 11),
                       __builtin_shufflevector(x, y, 4, 12, 5, 13, 6, 14, 7, 15)};
  Lanes const z0[2] = {__builtin_shufflevector(z, Lanes{}, 0, 8, 1, 9, 2, 10, 3, 11),
                       __builtin_shufflevector(z, Lanes{}, 4, 12, 5, 13, 6, 14, 7, 15)};
  for (int half = 0; half < 2; ++half) {
    store(out + 16 * half, __builtin_shufflevector(xy[half], z0[half], 0, 1, 8, 9, 2, 3, 10, 11));
    store(out + 16 * half + 8, __builtin_shufflevector(xy[half], z0[half], 4, 5, 12, 13, 6, 7, 14, 15));
  }
}

void fill_interior(Level const& level, int b, VectorCells const& cells, Tile<lanes>& tile) {
  Box const& box = level.box(b);
  int const length = box.extent(0), whole = length / lane_count * lane_count;
  LocalIndex place = level.local_offset(b);
  for (int k = box.lower[2]; k <= box.upper[2]; ++k)
    for (int j = box.lower[1]; j <= box.upper[1]; ++j) {
      Real* row = tile.row(box.lower[0], j, k);
      Real const *const x = cells.own[0] + place, *const y = cells.own[1] + place, *const z = cells.own[2] + place;
      for (int i = 0; i < whole; i += lane_count)
        interleave(load<Lanes>(x + i), load<Lanes>(y + i), load<Lanes>(z + i), row + lanes * i);
      row += lanes * whole;
      for (int i = whole; i < length; ++i, row += lanes) row[0] = x[i], row[1] = y[i], row[2] = z[i], row[3] = 0;
      place += length;
    }
}

void fill_shell(Hierarchy const& hierarchy, Surroundings const& at, VectorCells const& cells, VectorCells const& coarse,
                Tile<lanes>& tile) {
  Level const& level = hierarchy.level(at.level);
  LocalIndex const *place = at.shell.data(), *const end = place + at.shell.size();
  for_each_shell_row(level.box(at.box), [&](int first, int last, int j, int k) {
    Real* value = tile.row(first, j, k);
    for (int i = first; i <= last; ++i, ++place, value += lanes) {
      constexpr std::ptrdiff_t ahead = 24;  // these cells lie all over the memory
      if (end - place > ahead && place[ahead] >= 0) cells.prefetch(place[ahead]);
      if (*place >= 0)
        cells.get(*place, value);
      else
        interpolate(fold_at_walls({i, j, k}, level), at, hierarchy.level(at.level - 1), coarse, value);
    }
  });
}

void fill_coarse(CoarseCells const& at, VectorCells const& cells, Tile<lanes>& tile) {
  Real* value = tile.values();
  for (LocalIndex place : at.place) {
    if (place >= 0) cells.get(place, value);
    value += lanes;
  }
}

/// The tile averaged over the cloud of one of eight particles. `row_share` are the products of its shares along y and
/// z; two neighbours along x are read at once.
template <int width>
inline Cell average(Real const* corner, std::ptrdiff_t stride_y, std::ptrdiff_t stride_z, int i,
                    std::array<Lanes, width * width> const& row_share, std::array<Lanes, width> const& x_share) {
  Lanes pair{};
  Cell last{};
  for (int k = 0; k < width; ++k)
    for (int j = 0; j < width; ++j) {
      Real const* const row = corner + j * stride_y + k * stride_z;
      Real const share = row_share[width * k + j][i];
      if constexpr (width > 1) pair += share * load<Lanes>(row);
      if constexpr (width % 2) last += share * load<Cell>(row + lanes * (width - 1));
    }
  Cell sum{};
  if constexpr (width > 1) {
    sum = x_share[0][i] * __builtin_shufflevector(pair, pair, 0, 1, 2, 3);
    sum += x_share[1][i] * __builtin_shufflevector(pair, pair, 4, 5, 6, 7);
  }
  if constexpr (width % 2) sum += x_share[width - 1][i] * last;
  return sum;
}

/// The components of eight cells, each in a vector of its own.
inline std::array<Lanes, 3> separate(std::array<Cell, lane_count> const& cells) {
  Lanes pair[4], xy[2], z[2];
  for (int p = 0; p < 4; ++p) pair[p] = __builtin_shufflevector(cells[2 * p], cells[2 * p + 1], 0, 1, 2, 3, 4, 5, 6, 7);
  for (int h = 0; h < 2; ++h) {
    xy[h] = __builtin_shufflevector(pair[2 * h], pair[2 * h + 1], 0, 4, 8, 12, 1, 5, 9, 13);
    z[h] = __builtin_shufflevector(pair[2 * h], pair[2 * h + 1], 2, 6, 10, 14, 3, 7, 11, 15);
  }
  return {__builtin_shufflevector(xy[0], xy[1], 0, 1, 2, 3, 8, 9, 10, 11),
          __builtin_shufflevector(xy[0], xy[1], 4, 5, 6, 7, 12, 13, 14, 15),
          __builtin_shufflevector(z[0], z[1], 0, 1, 2, 3, 8, 9, 10, 11)};
}

/// Call use(group, field) for the groups of particles [first, last) with the tile averaged over their clouds.
template <class Shape, class Use>
void read_clouds(TileFrame const& frame, ParticleView const& particles, std::int64_t first, std::int64_t last,
                 Tile<lanes> const& tile, Use const& use) {
  constexpr int width = Shape::width;
  LocalIndex const stride_y = LocalIndex(tile.stride_y()), stride_z = LocalIndex(tile.stride_z());
  Real const* const origin = tile.values() + tile.box_corner();
  WideLanes all_in = WideLanes{} - 1;
  for_each_group(first, last, [&](LaneGroup const& group) {
    auto const s = frame.inside(particles, group, all_in);
    auto const x = Shape::at(s[0]), y = Shape::at(s[1]), z = Shape::at(s[2]);
    IndexLanes const corner = lanes * x.first + stride_y * y.first + stride_z * z.first;
    std::array<Lanes, width * width> row_share;
    for (int k = 0; k < width; ++k)
      for (int j = 0; j < width; ++j) row_share[width * k + j] = z.share[k] * y.share[j];
    std::array<Cell, lane_count> felt;
#pragma GCC unroll 8
    for (int i = 0; i < lane_count; ++i)
      felt[i] = average<width>(origin + corner[i], stride_y, stride_z, i, row_share, x.share);
    use(group, separate(felt));
  });
  frame.require_inside(all_in, particles, first, last);
}

/// Call use(group, field) for all particles of this rank, a group at a time. Collective.
template <class Use>
void read_field(ParticleMesh& mesh, Clouds const& clouds, std::array<Field const*, 3> const& field,
                ParticleView const& particles, std::int64_t const* starts, Use const& use) {
  Hierarchy const& hierarchy = mesh.hierarchy();
  BufferZone const* const zone = clouds.matched ? &mesh.buffer_zone() : nullptr;
  std::vector<VectorCells> own, coarse;
  for (int l = 0; l < hierarchy.level_count(); ++l) {
    own.push_back(with_ghosts(field, l, mesh.exchange(l)));
    if (zone) coarse.push_back(with_ghosts(field, l, zone->exchange(l)));
  }

  std::vector<Tile<lanes>> tiles(std::size_t(hierarchy.level_count()));  // by how much coarser than their box
  for_each_occupied_box(mesh, starts, [&](std::size_t slot, std::int64_t first, std::int64_t last) {
    Surroundings const& at = mesh.boxes()[slot];
    BoxBuffer const* const buffer = zone ? zone->box(slot) : nullptr;
    Level const& level = hierarchy.level(at.level);
    tiles[0].reset(level.box(at.box));
    fill_interior(level, at.box, own[at.level], tiles[0]);
    fill_shell(hierarchy, at, own[at.level], own[std::max(0, at.level - 1)], tiles[0]);
    for (std::size_t r = 1; buffer && r <= buffer->coarse.size(); ++r) {
      CoarseCells const& c = buffer->coarse[r - 1];
      tiles[r].reset(c.box);
      fill_coarse(c, coarse[c.level], tiles[r]);
    }
    for_each_run(mesh, at, buffer, particles, first, last, [&](int rise, TileFrame const& frame, auto from, auto to) {
      with_shape(clouds.shape, [&](auto s) { read_clouds<decltype(s)>(frame, particles, from, to, tiles[rise], use); });
    });
  });
}

}  // namespace

void gather(ParticleMesh& mesh, Clouds const& clouds, std::array<Field const*, 3> const& field,
            ParticleView const& particles, std::int64_t const* starts, std::array<Real*, 3> const& at_particles) {
  bool const far = are_far(particles.count, at_particles[0], at_particles[1], at_particles[2]);
  read_field(mesh, clouds, field, particles, starts, [&](LaneGroup const& group, std::array<Lanes, 3> const& felt) {
    for (int d = 0; d < 3; ++d) store(at_particles[d], group, felt[d], far);
  });
  stream_end();
}

void accelerate(ParticleMesh& mesh, Clouds const& clouds, std::array<Field const*, 3> const& field,
                ParticleView const& particles, std::int64_t const* starts, Kick const& kick,
                std::array<Real*, 3> const& now, std::array<Real*, 3> const& onward) {
  bool const far = are_far(particles.count, now[0], now[1], now[2], onward[0], onward[1], onward[2]);
  read_field(mesh, clouds, field, particles, starts, [&](LaneGroup const& group, std::array<Lanes, 3> const& felt) {
    Lanes const charge = kick.same_charge ? kick.charge[0] + Lanes{} : load(kick.charge, group);
    Lanes const before = kick.before * charge, after = kick.after * charge;
    for (int d = 0; d < 3; ++d) {
      Lanes const momentum = load(particles.momentum[d], group) + before * felt[d];
      store(now[d], group, momentum, far);
      store(onward[d], group, momentum + after * felt[d], far);
    }
  });
  stream_end();
}

}  // namespace amrpic
