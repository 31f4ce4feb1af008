#include "particle/deposit.hpp"

#include <algorithm>
#include <optional>
#include <type_traits>
#include <utility>

#include "base/fetch.hpp"
#include "particle/array_pool.hpp"
#include "particle/tile.hpp"
#include "particle/tile_batch.hpp"

namespace amrpic {

namespace {

/// The cells of a level that a rank's particles charge: its own ones, and the halo.
struct ChargeCells {
  Real *own, *halo;
  LocalIndex owned;
  Real& operator[](LocalIndex place) const { return place < owned ? own[place] : halo[place - owned]; }
};

/// Charge that this rank's particles leave on cells of other ranks, on its way to their owners.
class ChargeAcrossRanks {
 public:
  ChargeAcrossRanks(Halo const& halo, LargeArray<Real>& own)
      : halo_(&halo), own_(own.data()), values_(std::size_t(halo.size()), Real(0)) {}

  ChargeCells cells() { return {own_, values_.data(), halo_->owned()}; }

  /// Add it to what the owners have. Collective.
  void send() const { halo_->fold({own_}, {values_.data()}); }

 private:
  Halo const* halo_;
  Real* own_;
  std::vector<Real> values_;
};

/// Cells along x that are added to at once.
typedef Real TwoCells __attribute__((vector_size(16)));
typedef Real FourCells __attribute__((vector_size(32)));

/// Sums of charge in a slab and its ghost cells. All are zero before clouds are added, and again after all were taken
/// out.
struct ChargeTile : Tile<1> {
  /// Take the place of the box that follows along z, after all planes but those that both have were taken out.
  void follow(Box const& next) {
    Real *const shared = plane(next.lower[2] - tile_reach), *const end = shared + 2 * tile_reach * stride_z();
    std::copy(shared, end, values());
    std::fill(shared, end, Real(0));
    reset(next);
  }
  /// Take the sums of `count` cells along x out: call give(n, sums) for eight of them, the first of which is the nth
  /// one, and for the rest one by one.
  template <class Give>
  void take(int i, int j, int k, int count, Give&& give) {
    Real* const sums = row(i, j, k);
    int n = 0;
    for (; n + lane_count <= count; n += lane_count) {
      give(n, load<Lanes>(sums + n));
      store(sums + n, Lanes{});
    }
    for (; n < count; ++n) {
      give(n, sums[n]);
      sums[n] = 0;
    }
  }
};

/// The clouds of a block of particles: where they start in a tile, for each row of cells its charge, and particle by
/// particle the weights of the cells along a row.
template <int width>
struct CloudBlock {
  static constexpr int row = width == 3 ? 4 : 2;  ///< cells; nothing is added to the last one of four
  using Row = std::conditional_t<width == 3, FourCells, TwoCells>;
  alignas(64) LocalIndex corner[block_size];
  alignas(64) Real row_weight[width * width][block_size];
  alignas(64) Real x_weight[block_size * row];

  void put_x_weights(int i, std::array<Lanes, width> const& weight) {
    Real* const out = x_weight + row * i;
    if constexpr (width == 3) {
      interleave(weight[0], weight[1], weight[2], out);
    } else {
      auto const pairs = interleaved(weight[0], width > 1 ? weight[width - 1] : Lanes{});
      for (int n = 0; n < 2; ++n) store(out + lane_count * n, pairs[std::size_t(n)]);
    }
  }
};

/// Add the clouds of a block of particles to the tile.
template <int width>
void add(CloudBlock<width> const& clouds, LaneBlock const& block, ChargeTile& tile) {
  using Row = typename CloudBlock<width>::Row;
  std::ptrdiff_t const stride_y = tile.stride_y(), stride_z = tile.stride_z();
  Real* const origin = tile.values() + tile.box_corner();
  auto const add_one = [&](int i) {
    Real* const corner = origin + clouds.corner[i];
    Row const weights = load<Row>(clouds.x_weight + clouds.row * i);
    for (int k = 0; k < width; ++k)
      for (int j = 0; j < width; ++j) {
        Real* const cells = corner + j * stride_y + k * stride_z;
        store(cells, load<Row>(cells) + clouds.row_weight[width * k + j][i] * weights);
      }
  };
  if (block.whole())
    for (int i = 0; i < block_size; ++i) add_one(i);
  else
    for_each_bit(block.chosen, add_one);
}

/// Add the clouds of particles to a tile, in real particles per cell.
template <class Shape>
void add_clouds(TileFrame const& frame, ParticleView const& particles, Chosen const& chosen, ChargeTile& tile) {
  constexpr int width = Shape::width;
  Real const stride_y = Real(tile.stride_y()), stride_z = Real(tile.stride_z());
  WideLanes all_in = WideLanes{} - 1;
  chosen.for_each_block([=, &particles, &all_in, &tile](LaneBlock const& block) {
    CloudBlock<width> clouds;
    WideLanes in = WideLanes{} - 1;
    for_each_group(block, [=, &particles, &clouds, &in](LaneGroup const& group) {
      int const i = int(group.first - block.first);
      auto const s = frame.inside(particles, group, in);
      auto const x = Shape::at(s[0]), y = Shape::at(s[1]), z = Shape::at(s[2]);
      store(clouds.corner + i, to_index(x.first + stride_y * y.first + stride_z * z.first));
      Lanes const weight = load(particles.weight, particles.equal_weights, group);
      for (int k = 0; k < width; ++k)
        for (int j = 0; j < width; ++j) store(clouds.row_weight[width * k + j] + i, weight * z.weight[k] * y.weight[j]);
      clouds.put_x_weights(i, x.weight);
    });
    all_in &= in;
    add(clouds, block, tile);
  });
  frame.require_inside(all_in, particles, chosen);
}

/// Moves the tiles of one box's slabs into the density. It sets the box's cells, or adds to them if they are set; ghost
/// cells it collects, and adds them to the density when all boxes are set.
class BoxSums {
 public:
  /// `ghosts` has room for the sums of the ghost cells.
  BoxSums(Level const& level, BoxGhosts const& at, Real charge, ChargeCells const& cells, ChargeCells const& coarse,
          Real* ghosts)
      : at_(at),
        level_(level),
        box_(level.box(at.box)),
        per_cell_(charge / level.cell_volume()),
        cells_(cells),
        coarse_(coarse),
        own_(cells.own + level.local_offset(at.box)),
        ghost_sums_(ghosts) {}

  /// Take planes [first, last] out of the tile; each plane once for all of them. `adds`: to what is set.
  void take(int first, int last, ChargeTile& tile, bool adds) const {
    adds ? take<true>(first, last, tile) : take<false>(first, last, tile);
  }
  /// Set all to zero.
  void clear() const {
    std::fill_n(own_, box_.cells(), Real(0));
    std::fill_n(ghost_sums_, at_.ghosts.cells(), Real(0));
  }

  /// Add the ghost cells to the cells that they stand for.
  void add_ghosts() const {
    for (GhostRun const& run : at_.ghosts.runs()) {
      Real const* const sums = ghost_sums_ + run.number;
      if (run.place < 0)
        add_to_coarser(run, sums);
      else
        add(run, sums, &cells_[run.place]);
    }
  }

 private:
  template <bool adds>
  void take(int first, int last, ChargeTile& tile) const {
    for (int k = first; k <= last; ++k) {
      if (k >= box_.lower[2] && k <= box_.upper[2]) take_interior<adds>(k, tile);
      Real* out = ghost_sums_ + ghost_cells_below(box_, k);
      for_each_ghost_row(box_, k, [&](int from, int to, int j) {
        tile.take(from, j, k, to - from + 1, [&](int n, auto const& sums) { put<adds>(sums, out + n); });
        out += to - from + 1;
      });
    }
  }

  template <bool adds>
  void take_interior(int k, ChargeTile& tile) const {
    for (int j = box_.lower[1]; j <= box_.upper[1]; ++j) {
      Real* const out = own_ + box_.offset({box_.lower[0], j, k});
      tile.take(box_.lower[0], j, k, box_.extent(0), [&](int n, auto const& sums) {
        fetch<Use::write>(out + n + page<Real>, 1);
        put<adds>(per_cell_ * sums, out + n);
      });
    }
  }

  template <bool adds, class T>
  static void put(T const& values, Real* out) {
    store(out, adds ? load<T>(out) + values : values);
  }

  void add(GhostRun const& run, Real const* sums, Real* out) const {
    LocalIndex n = 0;
    if (run.place_stride == 1 && run.number_stride == 1)
      for (; n + lane_count <= run.count; n += lane_count)
        store(out + n, load<Lanes>(out + n) + per_cell_ * load<Lanes>(sums + n));
    for (; n < run.count; ++n) out[std::ptrdiff_t(n) * run.place_stride] += per_cell_ * sums[n * run.number_stride];
  }

  /// A cell that the level lacks lies in one of the coarser level, of eight times its volume.
  void add_to_coarser(GhostRun const& run, Real const* sums) const {
    for (LocalIndex n = 0; n < run.count; ++n)
      if (Real const sum = sums[n * run.number_stride]; sum != 0) {
        Index3 const parent = parent_of(level_.fold_at_walls(run.cell(n)));
        coarse_[at_.coarse[std::size_t(at_.parents.offset(parent))]] += per_cell_ / 8 * sum;
      }
  }

  BoxGhosts const& at_;
  Level const& level_;
  Box box_;
  Real per_cell_;
  ChargeCells cells_, coarse_;
  Real *own_, *ghost_sums_;
};

/// Zero the cells of boxes that hold no particle, and return how many ghost cells the others have.
std::size_t clear_empty_boxes(ParticleMesh const& mesh, std::int64_t const* starts, Field& density) {
  std::size_t ghosts = 0;
  for (std::size_t s = 0; s < mesh.boxes().size(); ++s) {
    BoxGhosts const& at = mesh.boxes()[s];
    Level const& level = mesh.hierarchy().level(at.level);
    if (starts[s] < starts[s + 1])
      ghosts += at.ghosts.cells();
    else
      std::fill_n(density.level(at.level).data() + level.local_offset(at.box), level.box(at.box).cells(), Real(0));
  }
  return ghosts;
}

/// Move the tile of coarse clouds into the density of its level.
void add_coarse_tile(ChargeTile& tile, CoarseCells const& at, Real per_cell, ChargeCells const& cells) {
  Box const box = at.box.grow(tile_reach);
  LocalIndex const* place = at.place.data();
  for_each_cell(box, [&](Index3 const& cell) {
    tile.take(cell[0], cell[1], cell[2], 1, [&](int, auto const& sum) {
      if constexpr (std::is_same_v<std::decay_t<decltype(sum)>, Real>)
        if (*place >= 0) cells[*place] += per_cell * sum;
    });
    ++place;
  });
}

/// Collects the charge of remote bricks in their regions.
class RemoteCharge {
 public:
  RemoteCharge(Hierarchy const& hierarchy, RemotePlan& plan, Real charge)
      : hierarchy_(hierarchy), plan_(plan), charge_(charge), values_(plan.cells(), Real(0)) {}

  /// Take the sums of a region out of a tile on the same cells.
  void take(std::size_t brick, std::size_t region, ChargeTile& tile) {
    Region const& of = plan_.bricks()[brick].regions[region];
    Real const per_cell = charge_ / hierarchy_.level(of.level).cell_volume();
    std::size_t const cells = std::size_t(of.cells.cells());
    Real *const sums = tile.values(), *const out = values_.data() + plan_.first(brick, region);
    for (std::size_t n = 0; n < cells; ++n) out[n] += per_cell * sums[n];
    std::fill_n(sums, cells, Real(0));
  }

  /// What overhangs walls moves to the cells there, and what lies in cells that the level lacks to coarser ones, of
  /// eight times their volume.
  void settle(std::size_t brick) {
    std::vector<Region> const& regions = plan_.bricks()[brick].regions;
    for (std::size_t w = 0; w < regions.size(); ++w) {
      Level const& level = hierarchy_.level(regions[w].level);
      Box const& cells = regions[w].cells;
      Real* const values = values_.data() + plan_.first(brick, w);
      if (!(level.cut_at_walls(cells) == cells))
        for_each_cell(cells, [&](Index3 const& cell) {
          Index3 const at = level.fold_at_walls(cell);
          if (at != cell) values[cells.offset(at)] += std::exchange(values[cells.offset(cell)], Real(0));
        });
      if (regions[w].whole || w + 1 == regions.size()) continue;
      Region const& coarser = regions[w + 1];
      for_each_missing(level, regions[w], [&](Index3 const& cell) {
        values_[plan_.first(brick, w + 1) + std::size_t(coarser.cells.offset(parent_of(cell)))] +=
            values[cells.offset(cell)] / 8;
      });
    }
  }

  void add_to(Field& density) { plan_.add(std::move(values_), density); }

 private:
  Hierarchy const& hierarchy_;
  RemotePlan& plan_;
  Real charge_;
  std::vector<Real> values_;
};

/// Particles of a box from which on their charge is moved into the density twice, once for those that arrive later: it
/// takes little beside theirs.
constexpr int per_cell_to_begin = 4;

}  // namespace

/// The charge of particles on its way to the density, slot by slot.
class Deposition::Sums {
 public:
  Sums(ParticleMesh& mesh, RemoteBricks const& remote, Clouds const& clouds, ParticleView const& particles,
       std::int64_t const* starts, Real charge, Field& density)
      : mesh_(mesh),
        hierarchy_(mesh.hierarchy()),
        zone_(clouds.matched ? &mesh.buffer_zone() : nullptr),
        clouds_(clouds),
        particles_(particles),
        starts_(starts),
        charge_(charge),
        density_(density),
        remote_plan_(remote.own_plan(clouds.matched)),
        boxes_(mesh.boxes().size()),
        slots_(boxes_ + remote.bricks().size()),
        waiting_(slots_, Part::all),
        is_set_(boxes_, false),
        ghost_sums_(clear_empty_boxes(mesh, starts, density)),
        tiles_(std::size_t(hierarchy_.level_count())),
        remote_charge_(hierarchy_, remote_plan_, charge) {
    for (int l = 0; l < hierarchy_.level_count(); ++l) {
      own_.emplace_back(mesh.halo(l), density.level(l));
      if (zone_) coarse_.emplace_back(zone_->halo(l), density.level(l));
    }
    Real* ghosts = ghost_sums_.data();
    for (std::size_t slot = 0; slot < boxes_; ++slot) {
      BoxGhosts const& at = mesh.boxes()[slot];
      box_sums_.emplace_back(hierarchy_.level(at.level), at, charge, own_[std::size_t(at.level)].cells(),
                             own_[std::size_t(std::max(0, at.level - 1))].cells(), ghosts);
      if (is_occupied(slot)) ghosts += at.ghosts.cells();
    }
    if (clouds.kernels)
      batch_.emplace(mesh, *clouds.kernels, particles_, [this](TileKernels const& kernels, auto const& on) {
        return kernels.deposit(clouds_.shape, particles_, on);
      });
  }

  void begin(std::vector<PlaceRange> const& under_way, std::function<void()> const& poll) {
    if (batch_) return;
    poll_ = poll;
    mark(under_way);
    try {
      for (std::size_t slot = 0; slot < slots_; ++slot) {
        std::int64_t const arriving = arriving_in_[slot], here = in_slot(slot) - arriving;
        bool const pays = here >= per_cell_to_begin * cells_of_slot(slot).cells();
        if (here > 0 && arriving == 0) add(slot, Part::all, Part::none);
        if (arriving > 0 && pays) add(slot, Part::here, Part::arriving);
        if (arriving > 0 && !pays && zone_) clear(slot);
      }
    } catch (Stray const& stray) {
      stray_ = stray;
    }
    poll_ = nullptr;
  }

  std::int64_t left() const {
    std::int64_t out = 0;
    for (std::size_t slot = 0; slot < slots_; ++slot) {
      if (waiting_[slot] == Part::all) out += in_slot(slot);
      if (waiting_[slot] == Part::arriving) out += arriving_in_[slot];
    }
    return out;
  }

  void finish() {
    auto const add_waiting = [&](std::size_t slot) {
      if (waiting_[slot] != Part::none) add(slot, waiting_[slot], Part::none);
    };
    for_each_occupied(
        mesh_, slots_ - boxes_, starts_, [&](std::size_t slot, auto, auto) { add_waiting(slot); },
        [&](std::size_t brick, auto, auto) { add_waiting(boxes_ + brick); },
        [&] {
          if (batch_) batch_->run();
          if (stray_) throw *stray_;
        });
    for (std::size_t slot = 0; slot < boxes_; ++slot)
      if (is_occupied(slot)) box_sums_[slot].add_ghosts();
    for (std::size_t slot = boxes_; slot < slots_; ++slot)
      if (is_occupied(slot)) remote_charge_.settle(slot - boxes_);
    for (ChargeAcrossRanks const& level : own_) level.send();
    for (ChargeAcrossRanks const& level : coarse_) level.send();
    remote_charge_.add_to(density_);

    mesh_.transfer().spread(density_);
    mesh_.transfer().average_down({&density_});
  }

 private:
  /// Particles of a slot.
  enum class Part : char { none, here, arriving, all };

  std::int64_t in_slot(std::size_t slot) const { return starts_[slot + 1] - starts_[slot]; }
  bool is_occupied(std::size_t slot) const { return in_slot(slot) > 0; }
  bool is_box(std::size_t slot) const { return slot < boxes_; }
  int level_of(std::size_t slot) const { return is_box(slot) ? mesh_.boxes()[slot].level : brick(slot).home.level; }
  BrickRegions const& brick(std::size_t slot) const { return remote_plan_.bricks()[slot - boxes_]; }
  Box cells_of_slot(std::size_t slot) const {
    return is_box(slot) ? hierarchy_.level(level_of(slot)).box(mesh_.boxes()[slot].box) : brick(slot).cells;
  }
  BoxBuffer const* buffer_of(std::size_t slot) const {
    if (is_box(slot)) return zone_ ? zone_->box(slot) : nullptr;
    return brick(slot).buffer.coarse.empty() ? nullptr : &brick(slot).buffer;
  }

  /// Note which are under way.
  void mark(std::vector<PlaceRange> const& under_way) {
    arriving_in_.assign(slots_, 0);
    arriving_.assign(std::size_t(particles_.count / block_size + 1), 0);
    for (auto const& [first, last] : under_way) {
      arriving_in_[std::size_t(std::upper_bound(starts_, starts_ + slots_, first) - starts_) - 1] += last - first;
      for (std::int64_t n = first; n < last; ++n)
        arriving_[std::size_t(n / block_size)] |= std::uint64_t(1) << (n % block_size);
    }
  }

  /// Let finer boxes add the coarse clouds of their particles to a box that waits.
  void clear(std::size_t slot) {
    if (!is_box(slot)) return;
    box_sums_[slot].clear();
    is_set_[slot] = true;
  }

  /// Deposit a part of a slot's particles, after which another one waits.
  void add(std::size_t slot, Part part, Part then) {
    waiting_[slot] = then;
    bits_ = {part == Part::all ? nullptr : arriving_.data(), part == Part::here};
    BoxBuffer const* const buffer = buffer_of(slot);
    std::size_t const depths = buffer ? buffer->coarse.size() : 0;
    std::vector<ChargeTile>& tiles = batch_ ? batch_->next() : tiles_;
    for (std::size_t r = 1; r <= depths; ++r) tiles[r].reset(buffer->coarse[r - 1].box);
    is_box(slot) ? add_box(slot, buffer, tiles) : add_remote(slot, buffer, tiles);
  }

  void add_box(std::size_t slot, BoxBuffer const* buffer, std::vector<ChargeTile>& tiles) {
    int const level = level_of(slot);
    Box const box = cells_of_slot(slot);
    BoxSums const& sums = box_sums_[slot];
    bool const adds = std::exchange(is_set_[slot], true);
    auto const take_coarse = [=, &tiles] {
      for (std::size_t r = 1; buffer && r <= buffer->coarse.size(); ++r) {
        CoarseCells const& c = buffer->coarse[r - 1];
        add_coarse_tile(tiles[r], c, charge_ / hierarchy_.level(c.level).cell_volume(),
                        coarse_[std::size_t(c.level)].cells());
      }
    };
    if (batch_) {
      tiles[0].reset(box);
      return batch_->add(level, box, buffer, starts_[slot], starts_[slot + 1], [=, &sums, &tiles] {
        sums.take(box.lower[2] - tile_reach, box.upper[2] + tile_reach, tiles[0], adds);
        take_coarse();
      });
    }
    for_each_slab(
        mesh_, level, box, planes_per_slab(box, 1), particles_, starts_[slot], starts_[slot + 1],
        [&](Box const& slab, auto from, auto to) {
          slab.lower[2] == box.lower[2] ? tiles[0].reset(slab) : tiles[0].follow(slab);
          add_slab(level, slab, buffer, from, to);
          bool const follows = slab.upper[2] < box.upper[2];  // then the last planes are those of the next too
          sums.take(slab.lower[2] - tile_reach, slab.upper[2] + (follows ? -tile_reach : tile_reach), tiles[0], adds);
        });
    take_coarse();
  }

  void add_remote(std::size_t slot, BoxBuffer const* buffer, std::vector<ChargeTile>& tiles) {
    std::size_t const number = slot - boxes_, depths = buffer ? buffer->coarse.size() : 0;
    Box const cells = cells_of_slot(slot);
    tiles[0].reset(cells);
    auto const take = [=, &tiles] {
      for (std::size_t r = 0; r <= depths; ++r) remote_charge_.take(number, r, tiles[r]);
    };
    if (batch_) return batch_->add(level_of(slot), cells, buffer, starts_[slot], starts_[slot + 1], take);
    add_slab(level_of(slot), cells, buffer, starts_[slot], starts_[slot + 1]);
    take();
  }

  void add_slab(int level, Box const& slab, BoxBuffer const* buffer, std::int64_t first, std::int64_t last) {
    for (std::int64_t from = first; from < last;) {
      std::int64_t const to = poll_ ? std::min(last, (from / between_polls + 1) * between_polls) : last;
      for_each_coarsening_depth(
          mesh_, level, slab, buffer, particles_, from, to, [&](int depth, TileFrame const& frame, Chosen chosen) {
            chosen.bits = bits_;
            with_shape(clouds_.shape,
                       [&](auto s) { add_clouds<decltype(s)>(frame, particles_, chosen, tiles_[std::size_t(depth)]); });
          });
      count_work(to - from);
      from = to;
    }
  }

  void count_work(std::int64_t particles) {
    since_poll_ += particles;
    if (poll_ && since_poll_ >= between_polls) poll_(), since_poll_ = 0;
  }

  static constexpr std::int64_t between_polls = 1 << 14;  ///< particles; about 0.1 ms

  ParticleMesh& mesh_;
  Hierarchy const& hierarchy_;
  BufferZone const* zone_;
  Clouds clouds_;
  ParticleView particles_;
  std::int64_t const* starts_;
  Real charge_;
  Field& density_;
  RemotePlan& remote_plan_;
  std::size_t boxes_, slots_;
  std::vector<Part> waiting_;              ///< particles of each slot
  std::vector<char> is_set_;               ///< whether the cells of each box hold charge, or zero
  std::vector<std::uint64_t> arriving_;    ///< bits
  std::vector<std::int64_t> arriving_in_;  ///< each slot
  ParticleBits bits_;                      ///< of those that are added
  std::function<void()> poll_;
  std::int64_t since_poll_ = 0;  ///< particles, or what takes as long
  std::optional<Stray> stray_;
  std::vector<ChargeAcrossRanks> own_, coarse_;
  Scratch<Real> ghost_sums_;
  std::vector<BoxSums> box_sums_;  ///< by slot
  std::vector<ChargeTile> tiles_;  ///< by how much coarser than their box
  std::optional<TileBatch<ChargeTile, 1>> batch_;
  RemoteCharge remote_charge_;
};

Deposition::Deposition(ParticleMesh& mesh, RemoteBricks const& remote, Clouds const& clouds,
                       ParticleView const& particles, std::int64_t const* starts, Real charge, Field& density)
    : sums_(std::make_unique<Sums>(mesh, remote, clouds, particles, starts, charge, density)) {}

Deposition::~Deposition() = default;

void Deposition::begin(std::vector<PlaceRange> const& under_way, std::function<void()> const& poll) {
  sums_->begin(under_way, poll);
}

void Deposition::finish() { sums_->finish(); }

std::int64_t Deposition::left() const { return sums_->left(); }

}  // namespace amrpic
