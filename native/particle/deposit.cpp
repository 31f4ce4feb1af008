#include "particle/deposit.hpp"

#include <algorithm>

#include "particle/tile.hpp"

namespace amrpic {

namespace {

/// Own cells of a level and the ghosts beyond them, kept apart.
struct Cells {
  Real* own;
  Real* ghosts;
  LocalIndex owned;
  Real& operator[](LocalIndex place) const { return place < owned ? own[place] : ghosts[place - owned]; }
};

/// Add the clouds of particles [first, last) to a tile, in real particles per cell.
template <class Shape>
void add_clouds(TileFrame const frame, ParticleView const particles, std::int64_t first, std::int64_t last,
                Tile<1>& tile) {
  constexpr int width = Shape::width;
  std::ptrdiff_t const stride_y = tile.stride_y(), stride_z = tile.stride_z();
  Real* const origin = tile.values() + tile.box_corner();
  for (std::int64_t n = first; n < last; ++n) {
    Real3 const s = frame.inside(particles, n);
    auto const x = Shape::at(s[0]), y = Shape::at(s[1]), z = Shape::at(s[2]);
    Real* const corner = origin + x.first + y.first * stride_y + z.first * stride_z;
    for (int k = 0; k < width; ++k)
      for (int j = 0; j < width; ++j) {
        Real const share = particles.weight[n] * z.share[k] * y.share[j];
        for (int i = 0; i < width; ++i) corner[i + j * stride_y + k * stride_z] += share * x.share[i];
      }
  }
}

/// Add a tile to the density: the interior to the box, the shell to whatever cells surround it.
void add_tile(Tile<1>& tile, Level const& level, Surroundings const& at, Real charge, Cells const& cells,
              Cells const& coarse) {
  Real const per_cell = charge / level.cell_volume(), per_parent = per_cell / 8;
  Box const& box = level.box(at.box);
  Real* out = cells.own + level.local_offset(at.box);
  for (int k = box.lower[2]; k <= box.upper[2]; ++k)
    for (int j = box.lower[1]; j <= box.upper[1]; ++j) {
      Real const* row = tile.row(box.lower[0], j, k);
      for (int i = 0; i < box.extent(0); ++i) out[i] += per_cell * row[i];
      out += box.extent(0);
    }
  LocalIndex const* place = at.shell.data();
  for_each_shell_row(box, [&](int first, int last, int j, int k) {
    Real const* value = tile.row(first, j, k);
    for (int i = first; i <= last; ++i, ++place, ++value) {
      if (*value == 0) continue;
      if (*place >= 0)
        cells[*place] += per_cell * *value;
      else
        coarse[at.coarse[std::size_t(~*place)]] += per_parent * *value;
    }
  });
}

/// Add the tile of coarse clouds to the density of its level.
void add_coarse_tile(Tile<1> const& tile, CoarseCells const& at, Real per_cell, Cells const& cells) {
  Real const* value = tile.values();
  for (std::size_t c = 0; c < at.place.size(); ++c)
    if (at.place[c] >= 0) cells[at.place[c]] += per_cell * value[c];
}

/// Charge of this rank's particles on the cells of a level, and on ghosts that are to be given to their owners.
class Layer {
 public:
  Layer(Exchange const& exchange, std::vector<Real>& own)
      : exchange_(&exchange), own_(own.data()), ghosts_(std::size_t(exchange.ghosts()), Real(0)) {}
  Cells cells() { return {own_, ghosts_.data(), exchange_->owned()}; }
  void fold() const { exchange_->fold({own_}, {ghosts_.data()}); }

 private:
  Exchange const* exchange_;
  Real* own_;
  std::vector<Real> ghosts_;
};

}  // namespace

void deposit(ParticleMesh& mesh, Clouds const& clouds, ParticleView const& particles, std::int64_t const* starts,
             Real charge, Field& density) {
  Hierarchy const& hierarchy = mesh.hierarchy();
  BufferZone const* const zone = clouds.matched ? &mesh.buffer_zone() : nullptr;
  std::vector<Layer> own, coarse;
  for (int l = 0; l < hierarchy.level_count(); ++l) {
    std::fill(density.level(l).begin(), density.level(l).end(), Real(0));
    own.emplace_back(mesh.exchange(l), density.level(l));
    if (zone) coarse.emplace_back(zone->exchange(l), density.level(l));
  }

  std::vector<Tile<1>> tiles(std::size_t(hierarchy.level_count()));  // by how much coarser than their box
  for_each_occupied_box(mesh, starts, [&](std::size_t slot, std::int64_t first, std::int64_t last) {
    Surroundings const& at = mesh.boxes()[slot];
    BoxBuffer const* const buffer = zone ? zone->box(slot) : nullptr;
    Level const& level = hierarchy.level(at.level);
    std::size_t const rises = buffer ? buffer->coarse.size() : 0;
    for (std::size_t r = 0; r <= rises; ++r) {
      tiles[r].reset(r == 0 ? level.box(at.box) : buffer->coarse[r - 1].box);
      tiles[r].clear();
    }
    for_each_run(mesh, at, buffer, particles, first, last, [&](int rise, TileFrame const& frame, auto from, auto to) {
      with_shape(clouds.shape, [&](auto s) { add_clouds<decltype(s)>(frame, particles, from, to, tiles[rise]); });
    });
    add_tile(tiles[0], level, at, charge, own[at.level].cells(), own[std::max(0, at.level - 1)].cells());
    for (std::size_t r = 1; r <= rises; ++r) {
      CoarseCells const& c = buffer->coarse[r - 1];
      add_coarse_tile(tiles[r], c, charge / hierarchy.level(c.level).cell_volume(), coarse[c.level].cells());
    }
  });
  for (Layer const& layer : own) layer.fold();
  for (Layer const& layer : coarse) layer.fold();

  mesh.transfer().spread(density);
  mesh.transfer().average_down({&density});
}

}  // namespace amrpic
