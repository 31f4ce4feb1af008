#pragma once

#include <mpi.h>

#include <algorithm>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "base/large_array.hpp"
#include "particle/box_frame.hpp"
#include "particle/bricks.hpp"
#include "particle/lane_groups.hpp"
#include "particle/particle_mesh.hpp"
#include "particle/view.hpp"

namespace amrpic {

/// A box and its ghost cells in memory of their own, `components` numbers per cell: what one box's particles touch.
template <int components>
class Tile {
 public:
  /// Take the place of another box. Values keep their places in memory, new ones are zero.
  void reset(Box const& box) {
    box_ = box.grow(tile_reach);
    lines_.resize(std::size_t(box_.cells()) * components / lane_count + 2);  // vectors may touch what follows
  }
  /// Take the place of the box that follows along z. Values of the planes that both have are moved along.
  void follow(Box const& next) {
    Real const* const kept = plane(next.lower[2] - tile_reach);
    std::copy(kept, kept + 2 * tile_reach * stride_z(), values());
    reset(next);
  }
  Box const& cells() const { return box_; }
  Real* row(int i, int j, int k) { return values() + components * box_.offset({i, j, k}); }
  Real* plane(int k) { return row(box_.lower[0], box_.lower[1], k); }
  Real const* values() const { return lines_[0].value; }
  Real* values() { return lines_[0].value; }
  std::ptrdiff_t box_corner() const { return tile_reach * (components + stride_y() + stride_z()); }  ///< first own cell
  std::ptrdiff_t stride_y() const { return std::ptrdiff_t(components) * box_.extent(0); }
  std::ptrdiff_t stride_z() const { return stride_y() * box_.extent(1); }

 private:
  struct alignas(64) CacheLine {
    Real value[lane_count];
  };
  Box box_;
  std::vector<CacheLine, CacheLines<CacheLine>> lines_;
};

/// A particle that is not where it was sorted; thrown on its rank alone, to be caught by `for_each_occupied`.
struct Stray {
  std::int64_t id;
};

/// Which particles of a rank are meant: a bit for each, `block_size` of them in a word.
struct ParticleBits {
  std::uint64_t const* words = nullptr;  ///< null: all are meant
  bool inverted = false;                 ///< whether those are meant whose bits are not set

  std::uint64_t of_block(std::int64_t first) const {
    if (!words) return ~std::uint64_t(0);
    return inverted ? ~words[first / block_size] : words[first / block_size];
  }
};

/// Particles [first, last) of a slab, or those of them with one coarsening `depth` and with `bits`.
struct Chosen {
  std::int64_t first, last;
  char const* depth = nullptr;  ///< of each from `first` on; null: all are chosen
  int wanted = 0;
  ParticleBits bits{};

  /// Call f(block) for the blocks in which there are any.
  template <class F>
  void for_each_block(F&& f) const {
    for (std::int64_t n = first / block_size * block_size; n < last; n += block_size) {
      int const from = int(std::max<std::int64_t>(0, first - n)),
                to = int(std::min<std::int64_t>(block_size, last - n));
      std::uint64_t chosen = (~std::uint64_t(0) >> (block_size - to)) & (~std::uint64_t(0) << from) & bits.of_block(n);
      for (int i = from; depth && i < to; ++i) chosen &= ~(std::uint64_t(depth[n + i - first] != wanted) << i);
      if (chosen != 0) f(LaneBlock{n, chosen});
    }
  }
};

/// One box's place in space, and what brings a particle's position into its tile.
class TileFrame {
 public:
  TileFrame(LevelCoordinates const& coordinates, Box const& box) : frame_{coordinates, box} {}

  /// Where a particle lies, as `BoxFrame` has it. Throws Stray if it lies outside the box.
  Real3 inside(ParticleView const& particles, std::int64_t n) const {
    Real3 s = particles.at(n);
    if (!frame_.enter(s)) throw Stray{particles.id[n]};
    return s;
  }

  /// The same of a group of particles; those outside the box are put into its corner, and their lanes of `all_in`
  /// cleared.
  std::array<Lanes, 3> inside(ParticleView const& particles, LaneGroup const& group, WideLanes& all_in) const {
    std::array<Lanes, 3> s;
    WideLanes in = WideLanes{} - 1;
    for (int d = 0; d < 3; ++d) {
      s[d] = frame_.coordinates.along(d, load(particles.position[d], group));
      in &= (s[d] >= Real(frame_.box.lower[d])) & (s[d] < Real(frame_.box.upper[d] + 1));
    }
    all_in &= in;
    for (int d = 0; d < 3; ++d) s[d] = select(in, s[d] - Real(frame_.box.lower[d]), Lanes{});
    return s;
  }

  /// Throw Stray if one of these particles lies outside the box, as `all_in` says.
  void require_inside(WideLanes const& all_in, ParticleView const& particles, Chosen const& chosen) const {
    if (bits_of(all_in) == all_lanes) return;
    chosen.for_each_block([&](LaneBlock const& block) {
      for_each_bit(block.chosen, [&](int i) { inside(particles, block.first + i); });
    });
  }

  /// The cell of the box's level that holds a particle. Throws Stray if the particle lies outside the box.
  Index3 cell(ParticleView const& particles, std::int64_t n) const {
    Real3 const s = inside(particles, n);
    Index3 out;
    for (int d = 0; d < 3; ++d) out[d] = int(s[d]) + frame_.box.lower[d];
    return out;
  }

 private:
  BoxFrame frame_;
};

/// Planes of a box, along z, whose tiles together fill about a third of a second-level cache; whole bricks.
inline int planes_per_slab(Box const& box, int components) {
  constexpr std::int64_t bytes = 3 << 17;
  std::int64_t const plane = box.grow(tile_reach).cells() / box.grow(tile_reach).extent(2) * components * 8;
  int const bricks = int(bytes / plane - 2 * tile_reach) / brick_shape[2];
  return std::max(1, bricks) * brick_shape[2];
}

/// Call f(slab, first, last) for the slabs of so many planes that a box is cut into, and the particles of each: those
/// of a box are sorted by brick, and slabs are whole bricks.
template <class F>
void for_each_slab(ParticleMesh const& mesh, int level, Box const& box, int planes, ParticleView const& particles,
                   std::int64_t first, std::int64_t last, F&& f) {
  LevelCoordinates const coordinates = mesh.locator().coordinates(level);
  for (Box slab = box; slab.lower[2] <= box.upper[2]; slab.lower[2] += planes) {
    slab.upper[2] = std::min(box.upper[2], slab.lower[2] + planes - 1);
    Real const end = slab.upper[2] < box.upper[2] ? slab.upper[2] + 1 : std::numeric_limits<Real>::infinity();
    std::int64_t next = last;
    for (std::int64_t low = first; low < next;) {
      std::int64_t const middle = low + (next - low) / 2;
      if (coordinates(particles.at(middle))[2] < end)
        low = middle + 1;
      else
        next = middle;
    }
    f(slab, first, next);
    first = next;
  }
}

/// Call f(depth, frame, chosen) for those of a slab's particles whose clouds lie on one level: `depth` levels coarser
/// than the slab, in a tile that `frame` describes. Without a buffer all of them lie on the slab's own level.
template <class F>
void for_each_coarsening_depth(ParticleMesh const& mesh, int level, Box const& slab, BoxBuffer const* buffer,
                               ParticleView const& particles, std::int64_t first, std::int64_t last, F&& f) {
  TileFrame const own(mesh.locator().coordinates(level), slab);
  if (first == last) return;
  if (!buffer) return f(0, own, Chosen{first, last});
  std::vector<char> depth;
  for (std::int64_t n = first; n < last; ++n) depth.push_back(char(buffer->depth_of(own.cell(particles, n))));
  auto const is_any = [&](int r) { return std::find(depth.begin(), depth.end(), r) != depth.end(); };
  if (is_any(0)) f(0, own, Chosen{first, last, depth.data(), 0});
  for (int r = 1; r <= int(buffer->coarse.size()); ++r) {
    CoarseCells const& c = buffer->coarse[std::size_t(r - 1)];
    if (is_any(r)) f(r, TileFrame(mesh.locator().coordinates(c.level), c.box), Chosen{first, last, depth.data(), r});
  }
}

/// Call of_box(slot, first, last) for each box of this rank that holds particles, [first, last) of them, then
/// of_remote(n, first, last) for those of `remote` remote bricks, then at_end(). If they throw a Stray on some ranks,
/// all throw std::out_of_range, so that none waits for another. Collective.
template <class OfBox, class OfRemote, class AtEnd>
void for_each_occupied(ParticleMesh const& mesh, std::size_t remote, std::int64_t const* starts, OfBox&& of_box,
                       OfRemote&& of_remote, AtEnd&& at_end) {
  constexpr std::int64_t none = std::numeric_limits<std::int64_t>::max();
  std::int64_t lowest = none;
  try {
    for (std::size_t s = 0; s < mesh.boxes().size(); ++s, ++starts)
      if (starts[0] < starts[1]) of_box(s, starts[0], starts[1]);
    for (std::size_t n = 0; n < remote; ++n, ++starts)
      if (starts[0] < starts[1]) of_remote(n, starts[0], starts[1]);
    at_end();
  } catch (Stray const& stray) {
    lowest = stray.id;
  }
  lowest = mesh.hierarchy().comm().smallest(lowest);
  if (lowest != none)
    throw std::out_of_range("particle " + std::to_string(lowest) +
                            " has left the box it was sorted into; migrate the particles first");
}

}  // namespace amrpic
