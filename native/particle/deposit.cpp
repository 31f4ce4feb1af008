#include "particle/deposit.hpp"

#include <algorithm>

#include "particle/shape.hpp"
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
void add_clouds(TileFrame const& frame, ParticleView const& particles, std::int64_t first, std::int64_t last,
                Tile<1>& tile) {
  std::ptrdiff_t const stride_y = tile.stride_y(), stride_z = tile.stride_z();
  for (std::int64_t n = first; n < last; ++n) {
    Real3 const s = frame.inside(particles, n);
    auto const x = Shape::at(s[0]), y = Shape::at(s[1]), z = Shape::at(s[2]);
    Real* const corner = tile.values() + x.first + y.first * stride_y + z.first * stride_z;
    for (int k = 0; k < Shape::width; ++k)
      for (int j = 0; j < Shape::width; ++j) {
        Real const share = particles.weight[n] * z.share[k] * y.share[j];
        for (int i = 0; i < Shape::width; ++i) corner[i + j * stride_y + k * stride_z] += share * x.share[i];
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

}  // namespace

void deposit(ParticleMesh const& mesh, ParticleView const& particles, std::int64_t const* starts, Real charge,
             Field& density) {
  Hierarchy const& hierarchy = mesh.hierarchy();
  int const levels = hierarchy.level_count();
  std::vector<std::vector<Real>> ghosts;
  std::vector<Cells> cells;
  for (int l = 0; l < levels; ++l) {
    std::fill(density.level(l).begin(), density.level(l).end(), Real(0));
    ghosts.emplace_back(std::size_t(mesh.exchange(l).ghosts()), Real(0));
    cells.push_back({density.level(l).data(), ghosts[l].data(), mesh.exchange(l).owned()});
  }

  Tile<1> tile;
  for_each_occupied_box(mesh, starts, [&](Surroundings const& at, TileFrame const& frame, auto first, auto last) {
    Level const& level = hierarchy.level(at.level);
    tile.reset(level.box(at.box));
    tile.clear();
    add_clouds<CloudInCell>(frame, particles, first, last, tile);
    add_tile(tile, level, at, charge, cells[at.level], cells[std::max(0, at.level - 1)]);
  });
  for (int l = 0; l < levels; ++l) mesh.exchange(l).fold({cells[l].own}, {cells[l].ghosts});

  mesh.transfer().spread(density);
  mesh.transfer().average_down({&density});
}

}  // namespace amrpic
