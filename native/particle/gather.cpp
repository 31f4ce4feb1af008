#include "particle/gather.hpp"

#include "particle/tile.hpp"

namespace amrpic {

namespace {

/// Three components per cell and one of padding, so that a cell fills a vector register.
constexpr int lanes = 4;

/// The three components of a field on one level: own cells, and ghosts beyond them.
struct VectorCells {
  std::array<Real const*, 3> own;
  std::array<std::vector<Real>, 3> ghosts;
  LocalIndex owned;

  void get(LocalIndex place, Real* out) const {
    for (int c = 0; c < 3; ++c) out[c] = place < owned ? own[c][place] : ghosts[c][std::size_t(place - owned)];
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

void fill_interior(Level const& level, int b, VectorCells const& cells, Tile<lanes>& tile) {
  Box const& box = level.box(b);
  LocalIndex place = level.local_offset(b);
  for (int k = box.lower[2]; k <= box.upper[2]; ++k)
    for (int j = box.lower[1]; j <= box.upper[1]; ++j) {
      Real* row = tile.row(box.lower[0], j, k);
      Real const *const x = cells.own[0] + place, *const y = cells.own[1] + place, *const z = cells.own[2] + place;
      for (int i = 0; i < box.extent(0); ++i, row += lanes) row[0] = x[i], row[1] = y[i], row[2] = z[i], row[3] = 0;
      place += box.extent(0);
    }
}

void fill_shell(Hierarchy const& hierarchy, Surroundings const& at, VectorCells const& cells, VectorCells const& coarse,
                Tile<lanes>& tile) {
  Level const& level = hierarchy.level(at.level);
  LocalIndex const* place = at.shell.data();
  for_each_shell_row(level.box(at.box), [&](int first, int last, int j, int k) {
    Real* value = tile.row(first, j, k);
    for (int i = first; i <= last; ++i, ++place, value += lanes) {
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

/// Average the tile over the clouds of particles [first, last).
template <class Shape>
void read_clouds(TileFrame const frame, ParticleView const particles, std::int64_t first, std::int64_t last,
                 Tile<lanes> const& tile, std::array<Real*, 3> const& out) {
  constexpr int width = decltype(Shape::at(0))::width;
  std::ptrdiff_t const stride_y = tile.stride_y(), stride_z = tile.stride_z();
  Real const* const origin = tile.values() + tile.box_corner();
  for (std::int64_t n = first; n < last; ++n) {
    Real3 const s = frame.inside(particles, n);
    auto const x = Shape::at(s[0]), y = Shape::at(s[1]), z = Shape::at(s[2]);
    Real const* const corner = origin + lanes * x.first + y.first * stride_y + z.first * stride_z;
    std::array<Real, lanes> sum{};
    for (int k = 0; k < width; ++k)
      for (int j = 0; j < width; ++j) {
        Real const share = z.share[k] * y.share[j];
        Real const* const row = corner + j * stride_y + k * stride_z;
        for (int i = 0; i < width; ++i)
          for (int c = 0; c < lanes; ++c) sum[c] += share * x.share[i] * row[lanes * i + c];
      }
    for (int c = 0; c < 3; ++c) out[c][n] = sum[c];
  }
}

}  // namespace

void gather(ParticleMesh& mesh, Clouds const& clouds, std::array<Field const*, 3> const& field,
            ParticleView const& particles, std::int64_t const* starts, std::array<Real*, 3> const& at_particles) {
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
      with_shape(clouds.shape,
                 [&](auto s) { read_clouds<decltype(s)>(frame, particles, from, to, tiles[rise], at_particles); });
    });
  });
}

}  // namespace amrpic
