#include "kokkos/particles.hpp"

#include <limits>
#include <utility>

#include "base/runtime.hpp"
#include "kokkos/arrays.hpp"

namespace amrpic::kokkos {

namespace {

constexpr int block = 64;  ///< particles that a thread of the host treats together
constexpr std::int64_t nobody = std::numeric_limits<std::int64_t>::max();

/// Particles [first, last) of one box.
struct Chunk {
  std::int64_t first, last;
  std::int32_t tile;         ///< of those whose clouds are as wide as the box's cells; coarser ones follow
  std::int32_t first_depth;  ///< of their coarsening depths on the parents of its cells; negative: all are 0
  Box parents;
};

/// Clouds of particles: where each begins among the numbers of a tile, and its weights.
template <class Shape, int most>
struct Clouds {
  static constexpr int width = Shape::width;
  int corner[most];
  Real row[width * width][most];  ///< products of the weights along y and z
  Real x[most][width];

  /// Set those of `count` particles; false if one of them lies outside the box. It counts as in its corner.
  template <int components>
  KOKKOS_INLINE_FUNCTION bool find(OnTiles::Numbers const& tile, std::array<Real*, 3> const& position,
                                   std::int64_t first, int count) {
    int all_in = 1;
    int const stride_y = int(tile.stride_y), stride_z = int(tile.stride_z), origin = int(tile.corner);
    for (int i = 0; i < count; ++i) {
      Real3 s{position[0][first + i], position[1][first + i], position[2][first + i]};
      bool const in = tile.frame.enter(s);
      all_in &= in;
      for (int d = 0; d < 3; ++d) s[d] = in && s[d] > 0 ? s[d] : 0;  // a contracted difference may lie below
      auto const at_x = Shape::at(s[0]), at_y = Shape::at(s[1]), at_z = Shape::at(s[2]);
      corner[i] = origin + components * int(at_x.first) + stride_y * int(at_y.first) + stride_z * int(at_z.first);
      for (int k = 0; k < width; ++k)
        for (int j = 0; j < width; ++j) row[width * k + j][i] = at_z.weight[k] * at_y.weight[j];
      for (int m = 0; m < width; ++m) x[i][m] = at_x.weight[m];
    }
    return all_in != 0;
  }
};

/// Adds clouds to tiles. On the host all particles of a tile are one thread's.
struct Add {
  static constexpr int components = 1;
  static constexpr bool writes_tiles = true;
  ParticleView particles;

  template <class Shape, int most>
  KOKKOS_INLINE_FUNCTION void operator()(Clouds<Shape, most> const& clouds, OnTiles::Numbers const& tile,
                                         std::int64_t first, int count) const {
    constexpr int width = Shape::width;
    for (int i = 0; i < count; ++i) {
      Real const weight = particles.weight[particles.equal_weights ? 0 : first + i];
      for (int k = 0; k < width; ++k)
        for (int j = 0; j < width; ++j) {
          Real* const cells = tile.values + (clouds.corner[i] + j * tile.stride_y + k * tile.stride_z);
          Real const of_row = weight * clouds.row[width * k + j][i];
          for (int m = 0; m < width; ++m)
            if constexpr (on_host)
              cells[m] += of_row * clouds.x[i][m];
            else
              Kokkos::atomic_add(cells + m, of_row * clouds.x[i][m]);
        }
    }
  }
};

/// Calls use(particle, field) for clouds in tiles.
template <class Use>
struct Average {
  static constexpr int components = 4;  ///< the last one is padding
  static constexpr bool writes_tiles = false;
  ParticleView particles;
  Use use;

  template <class Shape, int most>
  [[gnu::flatten]] KOKKOS_INLINE_FUNCTION void operator()(Clouds<Shape, most> const& clouds,
                                                          OnTiles::Numbers const& tile, std::int64_t first,
                                                          int count) const {
    constexpr int width = Shape::width;
    Real felt[3][most];
    for (int i = 0; i < count; ++i) {
      Real sum[components] = {};
      for (int k = 0; k < width; ++k)
        for (int j = 0; j < width; ++j) {
          Real const* const cells = tile.values + (clouds.corner[i] + j * tile.stride_y + k * tile.stride_z);
          Real const of_row = clouds.row[width * k + j][i];
          for (int m = 0; m < width; ++m) {
            Real const weight = of_row * clouds.x[i][m];
            for (int c = 0; c < components; ++c) sum[c] += weight * cells[components * m + c];
          }
        }
      for (int d = 0; d < 3; ++d) felt[d][i] = sum[d];
    }
#pragma GCC ivdep
    for (int i = 0; i < count; ++i) use(Single{first + i}, Real3{felt[0][i], felt[1][i], felt[2][i]});
  }
};

struct Write {
  std::array<Real*, 3> to;
  KOKKOS_INLINE_FUNCTION void operator()(Single at, Real3 const& felt) const {
    for (std::size_t d = 0; d < 3; ++d) to[d][at.n] = felt[d];
  }
};
struct MoveByMesh {
  Mover mover;
  KOKKOS_INLINE_FUNCTION void operator()(Single at, Real3 const& felt) const { mover.by_mesh(at, felt); }
};
struct MoveByFields {
  Mover mover;
  KOKKOS_INLINE_FUNCTION void operator()(Single at, Real3 const& felt) const { mover.by_fields(at, felt); }
};

/// Gives the particles of a chunk to an act.
template <class Shape, class Act>
struct OverChunk {
  Array<Chunk> chunks;
  Array<OnTiles::Numbers> tiles;
  Array<char> depths;
  Array<std::int64_t> stray;
  Act act;

  KOKKOS_INLINE_FUNCTION void operator()(Worker const& worker, std::int32_t n) const {
    Chunk const& chunk = chunks(n);
    if constexpr (on_host) {
      if (chunk.first_depth < 0)
        for (std::int64_t i = chunk.first; i < chunk.last; i += block)
          treat<block>(tiles(chunk.tile), i, int(i + block < chunk.last ? block : chunk.last - i));
      else
        for (std::int64_t i = chunk.first; i < chunk.last; ++i) treat<1>(tile_of(chunk, i), i, 1);
    } else {
      worker.for_each(int(chunk.last - chunk.first),
                      [&](int i) { treat<1>(tile_of(chunk, chunk.first + i), chunk.first + i, 1); });
    }
  }

 private:
  template <int most>
  KOKKOS_INLINE_FUNCTION void treat(OnTiles::Numbers const& tile, std::int64_t first, int count) const {
    Clouds<Shape, most> clouds;
    if (!clouds.template find<Act::components>(tile, act.particles.position, first, count))
      for (int i = 0; i < count; ++i)
        if (Real3 s = place(first + i); !tile.frame.enter(s)) Kokkos::atomic_fetch_min(&stray(0), first + i);
    act(clouds, tile, first, count);
  }
  KOKKOS_INLINE_FUNCTION Real3 place(std::int64_t n) const {
    auto const& x = act.particles.position;
    return {x[0][n], x[1][n], x[2][n]};
  }
  /// By the depth of the particle's cell; the box's own tile if it lies outside, which `treat` reports.
  KOKKOS_INLINE_FUNCTION OnTiles::Numbers const& tile_of(Chunk const& chunk, std::int64_t n) const {
    OnTiles::Numbers const& own = tiles(chunk.tile);
    Real3 s = place(n);
    if (chunk.first_depth < 0 || !own.frame.enter(s)) return own;
    Index3 parent;
    for (int d = 0; d < 3; ++d)
      parent[d] = floor_divide(own.frame.box.lower[d] + int(s[d]), 2) - chunk.parents.lower[d];
    std::ptrdiff_t const place = parent[0] + chunk.parents.stride(1) * parent[1] + chunk.parents.stride(2) * parent[2];
    return tiles(chunk.tile + depths(std::size_t(chunk.first_depth + place)));
  }
};

/// What kernels have of the host's values, in one run after another. Goes before Kokkos does.
struct Kept {
  std::vector<Mirrored<Real>> columns;
  Array<Real> tiles;
  AtFinalize release{[this] { columns.clear(), tiles = {}; }};
};
Kept& kept() {
  static auto* const the_one = new Kept;
  return *the_one;
}

/// Columns of particles [first, last) in the kernels' memory, each from where number 0 would be.
class Columns {
 public:
  explicit Columns(std::vector<OnTiles> const& on) : first_(on.front().first), count_(on.back().last - first_) {}
  Real* read(Real const* column, bool is_one = false) {
    if (!column) return nullptr;
    std::int64_t const first = is_one ? 0 : first_;
    Mirrored<Real> const& values = next(const_cast<Real*>(column) + first, is_one ? 1 : count_);
    values.to_device();
    return values.array().data() - first;
  }
  Real* written(Real* column) {
    if (!column) return nullptr;
    written_.push_back(used_);
    return next(column + first_, count_).array().data() - first_;
  }
  std::array<Real*, 3> read(std::array<Real*, 3> const& of) { return {read(of[0]), read(of[1]), read(of[2])}; }
  std::array<Real*, 3> written(std::array<Real*, 3> const& of) {
    return {written(of[0]), written(of[1]), written(of[2])};
  }
  void to_host() const {
    for (std::size_t n : written_) kept().columns[n].to_host();
  }

 private:
  Mirrored<Real> const& next(Real* host, std::int64_t count) {
    auto& columns = kept().columns;
    if (used_ == columns.size()) columns.emplace_back();
    columns[used_].stand_for(host, std::size_t(count));
    return columns[used_++];
  }

  std::int64_t first_, count_;
  std::size_t used_ = 0;
  std::vector<std::size_t> written_;
};

/// The values of tiles side by side in the kernels' memory, or, where that is the host's, where they are.
class TileValues {
 public:
  explicit TileValues(std::vector<OnTiles> const& on) {
    if constexpr (on_host) return;
    std::size_t count = 0;
    for (OnTiles const& box : on)
      for (OnTiles::Numbers const& tile : box.by_depth) count += std::size_t(tile.count);
    if (kept().tiles.size() < count) {
      kept().tiles = {};
      kept().tiles = Array<Real>(Kokkos::view_alloc(Kokkos::WithoutInitializing, "tiles"), count);
    }
  }
  /// The place of the next one.
  Real* next(OnTiles::Numbers const& tile) {
    if constexpr (on_host) return tile.values;
    std::size_t const first = last_;
    last_ += std::size_t(tile.count);
    places_.emplace_back(OnHost<Real>(tile.values, std::size_t(tile.count)),
                         Kokkos::subview(kept().tiles, std::make_pair(first, last_)));
    return places_.back().second.data();
  }
  void to_device() const {
    for (auto const& [host, values] : places_) Kokkos::deep_copy(Space(), values, host);
  }
  void zeros_to_device() const { fill(kept().tiles, Real(0)); }
  void to_host() const {
    for (auto const& [host, values] : places_) Kokkos::deep_copy(Space(), host, values);
    Kokkos::fence();
  }

 private:
  std::vector<std::pair<OnHost<Real>, Array<Real>>> places_;
  std::size_t last_ = 0;
};

/// Run an act over all particles; return the first that lies outside its box, or -1.
template <class Act>
std::int64_t run(char const* name, Shape shape, std::vector<OnTiles> const& on, Act const& act) {
  constexpr std::int64_t together = on_host && Act::writes_tiles ? nobody : 2048;
  std::vector<Chunk> chunks;
  std::vector<OnTiles::Numbers> tiles;
  std::vector<char> depths;
  TileValues values(on);
  for (OnTiles const& box : on) {
    Chunk chunk{box.first, box.last, std::int32_t(tiles.size()), -1, {}};
    if (box.buffer) {
      chunk.first_depth = std::int32_t(depths.size()), chunk.parents = box.buffer->depth.box();
      depths.insert(depths.end(), box.buffer->depth.values().begin(), box.buffer->depth.values().end());
    }
    for (std::int64_t first = box.first; first < box.last; first = chunk.last) {
      chunk.first = first, chunk.last = box.last - first > together ? first + together : box.last;
      chunks.push_back(chunk);
    }
    for (OnTiles::Numbers tile : box.by_depth) {
      tile.values = values.next(tile);
      tiles.push_back(tile);
    }
  }
  Act::writes_tiles ? values.zeros_to_device() : values.to_device();
  Array<std::int64_t> const stray("particle outside its box", 1);
  Kokkos::deep_copy(stray, nobody);
  with_shape(shape, [&](auto s) {
    auto const list = on_device(chunks);
    for_each_row(name, list, OverChunk<decltype(s), Act>{list, on_device(tiles), on_device(depths), stray, act});
  });
  if (Act::writes_tiles) values.to_host();
  std::int64_t first;
  Kokkos::deep_copy(first, Kokkos::subview(stray, 0));
  return first == nobody ? -1 : first;
}

class Kernels : public TileKernels {
 public:
  std::int64_t cells_at_once() const override {
    return !on_host || Space().concurrency() > 1 ? 1 << 24 : 1 << 15;  // by one thread, in its second-level cache
  }
  std::int64_t deposit(Shape shape, ParticleView const& particles, std::vector<OnTiles> const& on) const override {
    Columns columns(on);
    return run("deposit", shape, on, Add{view(columns, particles)});
  }
  std::int64_t gather(Shape shape, ParticleView const& particles, std::vector<OnTiles> const& on,
                      std::array<Real*, 3> const& out) const override {
    Columns columns(on);
    Write const write{columns.written(out)};
    std::int64_t const stray = run("gather", shape, on, Average<Write>{view(columns, particles), write});
    columns.to_host();
    return stray;
  }
  std::int64_t push(Shape shape, ParticleView const& particles, std::vector<OnTiles> const& on,
                    Mover const& mover) const override {
    Columns columns(on);
    Mover here = mover;
    here.particles = view(columns, particles);
    here.particles.momentum = columns.read(particles.momentum);
    here.motion.charge = columns.read(mover.motion.charge, mover.motion.same);
    here.motion.inverse_mass = columns.read(mover.motion.inverse_mass, mover.motion.same);
    here.motion.added = {columns.read(mover.motion.added.electric), columns.read(mover.motion.added.magnetic)};
    here.out = {columns.written(mover.out.momentum), columns.written(mover.out.position),
                columns.written(mover.out.between)};
    std::int64_t const stray = mover.has_more() ? run("push", shape, on, Average<MoveByFields>{here.particles, {here}})
                                                : run("push", shape, on, Average<MoveByMesh>{here.particles, {here}});
    columns.to_host();
    return stray;
  }

 private:
  static ParticleView view(Columns& columns, ParticleView const& particles) {
    ParticleView out = particles;
    out.position = columns.read(particles.position);
    out.weight = columns.read(particles.weight, particles.equal_weights);
    return out;
  }
};

}  // namespace

TileKernels const& tile_kernels() {
  require_kokkos();
  static Kernels const kernels;
  return kernels;
}

}  // namespace amrpic::kokkos
