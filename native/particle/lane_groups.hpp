// Eight particles at a time.
#pragma once

#include <cstdint>

#include "base/lanes.hpp"

namespace amrpic {

constexpr IndexLanes index_of_lane = {0, 1, 2, 3, 4, 5, 6, 7};

/// The first `count` numbers, or as many as there are lanes; behind those zeros.
inline Lanes load_up_to(Real const* from, std::int64_t count) {
  return count >= lane_count ? load<Lanes>(from) : load_some(from, (1u << count) - 1);
}

/// Ask for what lies at an address to be brought into the second-level cache: what is asked for well ahead of its use
/// would not stay in the first one, and displace what is in use there. Any address will do.
inline void bring_near(void const* address) {
  __builtin_prefetch(address, 0, 2);
  asm volatile("");  // else a function that does nothing but this counts as one without effect, and calls are dropped
}

/// The values at eight places. One by one: where processors work around the leak of gather instructions, these wait for
/// each other.
inline Lanes pick(Real const* from, LocalIndex const* n) {
  return Lanes{from[n[0]], from[n[1]], from[n[2]], from[n[3]], from[n[4]], from[n[5]], from[n[6]], from[n[7]]};
}

/// Those of eight consecutive places, starting at a multiple of eight, that are meant: a bit for each.
struct LaneGroup {
  std::int64_t first;
  unsigned lanes;
  bool whole() const { return lanes == all_lanes; }
  int first_lane() const { return __builtin_ctz(lanes); }
  int last() const { return 31 - __builtin_clz(lanes); }
};

/// Particles that pass through the parts of a kernel together. What one part leaves to the next stays in the
/// first-level cache, and the processor works on many of them at a time, where part after part for each would be one
/// long wait.
constexpr int block_size = 8 * lane_count;

/// Those of a block of consecutive places, starting at a multiple of `block_size`, that are meant: a bit for each.
struct LaneBlock {
  std::int64_t first;
  std::uint64_t chosen;
  bool whole() const { return chosen == ~std::uint64_t(0); }
};

/// Call f(group) for the groups of a block of which any place is meant. All of `f` is compiled into both loops.
template <class F>
[[gnu::flatten]] inline void for_each_group(LaneBlock const& block, F&& f) {
  if (block.whole())  // the compiler makes a loop of its own for this
    for (int i = 0; i < block_size; i += lane_count) f(LaneGroup{block.first + i, all_lanes});
  else
    for (int i = 0; i < block_size; i += lane_count)
      if (unsigned const lanes = unsigned(block.chosen >> i) & all_lanes; lanes != 0)
        f(LaneGroup{block.first + i, lanes});
}

/// The values of a group; lanes beyond it get one of its own.
inline Lanes load(Real const* values, LaneGroup const& g) {
  if (g.whole()) return load<Lanes>(values + g.first);
  Lanes const one = values[g.first + g.first_lane()] + Lanes{};
  return select(mask_of(g.lanes), load_some(values + g.first, g.lanes), one);
}

/// The same; if there is `one` for all, that one.
inline Lanes load(Real const* values, bool one, LaneGroup const& g) {
  return one ? values[0] + Lanes{} : load(values, g);
}

/// Write a group, past the cache if the values are `far` and start on a cache line.
inline void store(Real* values, LaneGroup const& g, Lanes const& from, bool far) {
  if (!g.whole()) {
    store_some(values + g.first, g.lanes, from);
  } else if (far) {
    stream(values + g.first, from);
  } else {
    store(values + g.first, from);
  }
}

/// So many particles stay in a cache until the next stage wants them.
constexpr std::int64_t cached_particles = 200000;

/// Whether arrays of so many particles are better written past the cache, and can be.
template <class... Columns>
bool are_far(std::int64_t count, Columns... columns) {
  return count > cached_particles && ((reinterpret_cast<std::uintptr_t>(columns) % sizeof(Lanes) == 0) && ...);
}

}  // namespace amrpic
