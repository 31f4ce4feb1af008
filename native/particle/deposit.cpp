#include "particle/deposit.hpp"

#include <algorithm>
#include <type_traits>

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

/// Cells along x that are added to at once.
typedef Real Pair __attribute__((vector_size(16)));
typedef Real Row __attribute__((vector_size(32)));

/// What clouds are added to. A processor hands a number that was just written to its next reader only if both take the
/// same bytes: so clouds that are two cells wide go to one tile if they start at an even cell along x, to the other if
/// at an odd one. Within each, two clouds touch the same pairs of cells, or pairs that have none in common.
struct CloudTiles {
  std::array<Tile<1>, 2> by_parity;

  /// Take the place of another box. Values are zero then if all of the box before were taken out.
  void reset(Box const& box) {
    for (Tile<1>& tile : by_parity) tile.reset(box);
  }
  /// Take the sums of `count` cells from cell n on out of the tiles.
  void take(std::size_t n, int count, Real* out) {
    Real *const even = by_parity[0].values() + n, *const odd = by_parity[1].values() + n;
    for (int i = 0; i < count; ++i) out[i] = even[i] + odd[i];
    std::fill(even, even + count, Real(0));
    std::fill(odd, odd + count, Real(0));
  }
};

/// The shares of eight particles along x, particle by particle.
template <int width>
inline void transpose(std::array<Lanes, width> const& share, Real* out) {
  static_assert(width <= 2);
  Lanes const second = width > 1 ? share[width - 1] : Lanes{};
  store(out, __builtin_shufflevector(share[0], second, 0, 8, 1, 9, 2, 10, 3, 11));
  store(out + 8, __builtin_shufflevector(share[0], second, 4, 12, 5, 13, 6, 14, 7, 15));
}

/// Adds clouds of one or two cells along x.
template <int width>
class PairAdder {
 public:
  explicit PairAdder(CloudTiles& tiles)
      : origin_{tiles.by_parity[0].values() + tiles.by_parity[0].box_corner(),
                tiles.by_parity[1].values() + tiles.by_parity[1].box_corner()},
        stride_y_(tiles.by_parity[0].stride_y()),
        stride_z_(tiles.by_parity[0].stride_z()) {}

  /// Add the clouds of a group: their first cells along x and in the tile, and for each row of cells its charge.
  void add(LaneGroup const& group, IndexLanes const& first_x, IndexLanes const& first,
           std::array<Lanes, width * width> const& row_share, std::array<Lanes, width> const& x_share) {
    alignas(64) Real along_x[2 * lane_count];
    transpose<width>(x_share, along_x);
    for (int i = group.from; i < group.to; ++i) {
      Real* const corner = origin_[first_x[i] & 1] + first[i];
      Pair const shares = load<Pair>(along_x + 2 * i);
      for (int k = 0; k < width; ++k)
        for (int j = 0; j < width; ++j) {
          Real* const cells = corner + j * stride_y_ + k * stride_z_;
          store(cells, load<Pair>(cells) + row_share[width * k + j][i] * shares);
        }
    }
  }
  void finish() {}

 private:
  std::array<Real*, 2> origin_;
  std::ptrdiff_t stride_y_, stride_z_;
};

/// Adds clouds of three cells along x. Those of all particles in a cell touch the same cells, so they are summed up in
/// registers until a particle of another cell comes.
class RowAdder {
 public:
  explicit RowAdder(CloudTiles& tiles)
      : origin_(tiles.by_parity[0].values() + tiles.by_parity[0].box_corner()),
        stride_y_(tiles.by_parity[0].stride_y()),
        stride_z_(tiles.by_parity[0].stride_z()) {}

  void add(LaneGroup const& group, IndexLanes const&, IndexLanes const& first, std::array<Lanes, 9> const& row_share,
           std::array<Lanes, 3> const& x_share) {
    for (int i = group.from; i < group.to; ++i) {
      if (first[i] != at_) {
        finish();
        at_ = first[i];
      }
      Row const shares{x_share[0][i], x_share[1][i], x_share[2][i], 0};
      for (int row = 0; row < 9; ++row) sum_[row] += row_share[row][i] * shares;
    }
  }
  void finish() {
    for (int row = 0; row < 9; ++row) {
      Real* const cells = origin_ + at_ + row % 3 * stride_y_ + row / 3 * stride_z_;
      store(cells, load<Row>(cells) + sum_[row]);  // nothing is added to the fourth cell
      sum_[row] = Row{};
    }
  }

 private:
  Real* origin_;
  std::ptrdiff_t stride_y_, stride_z_;
  LocalIndex at_ = 0;
  std::array<Row, 9> sum_{};
};

/// Add the clouds of particles [first, last) to a tile, in real particles per cell.
template <class Shape>
void add_clouds(TileFrame const& frame, ParticleView const& particles, std::int64_t first, std::int64_t last,
                CloudTiles& tiles) {
  constexpr int width = Shape::width;
  Real const stride_y = Real(tiles.by_parity[0].stride_y()), stride_z = Real(tiles.by_parity[0].stride_z());
  std::conditional_t<width == 3, RowAdder, PairAdder<std::min(width, 2)>> adder(tiles);
  WideLanes all_in = WideLanes{} - 1;
  for_each_group(first, last, [&](LaneGroup const& group) {
    auto const s = frame.inside(particles, group, all_in);
    auto const x = Shape::at(s[0]), y = Shape::at(s[1]), z = Shape::at(s[2]);
    Lanes const weight = load(particles.weight, group);
    std::array<Lanes, width * width> row_share;
    for (int k = 0; k < width; ++k)
      for (int j = 0; j < width; ++j) row_share[width * k + j] = weight * z.share[k] * y.share[j];
    adder.add(group, convert<IndexLanes>(x.first),
              convert<IndexLanes>(x.first + stride_y * y.first + stride_z * z.first), row_share, x.share);
  });
  adder.finish();
  frame.require_inside(all_in, particles, first, last);
}

/// Move a tile into the density: the interior to the box, the shell to whatever cells surround it.
void add_tile(CloudTiles& tiles, Level const& level, Surroundings const& at, Real charge, Cells const& cells,
              Cells const& coarse) {
  Real const per_cell = charge / level.cell_volume(), per_parent = per_cell / 8;
  Box const &box = level.box(at.box), whole = box.grow(tile_reach);
  std::vector<Real> row(std::size_t(whole.extent(0)));
  Real* out = cells.own + level.local_offset(at.box);
  for (int k = box.lower[2]; k <= box.upper[2]; ++k)
    for (int j = box.lower[1]; j <= box.upper[1]; ++j) {
      tiles.take(std::size_t(whole.offset({box.lower[0], j, k})), box.extent(0), row.data());
      for (int i = 0; i < box.extent(0); ++i) out[i] += per_cell * row[i];
      out += box.extent(0);
    }
  std::size_t n = 0;
  for_each_shell_row(box, [&](int first, int last, int j, int k) {
    tiles.take(std::size_t(whole.offset({first, j, k})), last - first + 1, row.data());
    for (int i = 0; i <= last - first; ++i, ++n) {
      constexpr std::size_t ahead = 24;  // these cells lie all over the memory
      if (n + ahead < at.shell.size() && at.shell[n + ahead] >= 0) bring_near(&cells[at.shell[n + ahead]]);
      LocalIndex const place = at.shell[n];
      if (row[i] == 0) continue;
      if (place >= 0)
        cells[place] += per_cell * row[i];
      else
        coarse[at.coarse[std::size_t(~place)]] += per_parent * row[i];
    }
  });
}

/// Move the tile of coarse clouds into the density of its level.
void add_coarse_tile(CloudTiles& tiles, CoarseCells const& at, Real per_cell, Cells const& cells) {
  for (std::size_t c = 0; c < at.place.size(); ++c) {
    Real value;
    tiles.take(c, 1, &value);
    if (at.place[c] >= 0) cells[at.place[c]] += per_cell * value;
  }
}

/// Charge of this rank's particles on the cells of a level, and on ghosts that are to be given to their owners.
class Layer {
 public:
  Layer(Exchange const& exchange, LargeArray<Real>& own)
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
    own.emplace_back(mesh.exchange(l), density.level(l));
    if (zone) coarse.emplace_back(zone->exchange(l), density.level(l));
  }

  std::vector<CloudTiles> tiles(std::size_t(hierarchy.level_count()));  // by how much coarser than their box
  for_each_occupied_box(mesh, starts, [&](std::size_t slot, std::int64_t first, std::int64_t last) {
    Surroundings const& at = mesh.boxes()[slot];
    BoxBuffer const* const buffer = zone ? zone->box(slot) : nullptr;
    Level const& level = hierarchy.level(at.level);
    std::size_t const rises = buffer ? buffer->coarse.size() : 0;
    for (std::size_t r = 0; r <= rises; ++r) tiles[r].reset(r == 0 ? level.box(at.box) : buffer->coarse[r - 1].box);
    for_each_run(mesh, at, level.box(at.box), buffer, particles, first, last,
                 [&](int rise, TileFrame const& frame, auto from, auto to) {
                   with_shape(clouds.shape,
                              [&](auto s) { add_clouds<decltype(s)>(frame, particles, from, to, tiles[rise]); });
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
