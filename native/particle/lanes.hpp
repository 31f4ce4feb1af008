// Eight particles at a time, in GCC's vector types: the compiler splits them into the vectors that the processor has,
// so one text serves all.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>

#ifdef __AVX512F__
#include <immintrin.h>
#endif

#include "base/types.hpp"

// How vectors are passed matters between object files built for different processors; here all is inlined.
#pragma GCC diagnostic ignored "-Wpsabi"

namespace amrpic {

constexpr int lane_count = 8;

typedef Real Lanes __attribute__((vector_size(8 * lane_count)));
typedef std::int64_t WideLanes
    __attribute__((vector_size(8 * lane_count)));  ///< also a comparison: all bits set, or none
typedef std::int32_t IndexLanes __attribute__((vector_size(4 * lane_count)));

constexpr WideLanes lane_number = {0, 1, 2, 3, 4, 5, 6, 7};

template <class Vector>
inline Vector load(void const* from) {
  Vector out;
  std::memcpy(&out, from, sizeof out);
  return out;
}

template <class Vector>
inline void store(void* to, Vector const& values) {
  std::memcpy(to, &values, sizeof values);
}

/// Ask for what lies at an address to be brought into the cache; any address will do.
inline void bring_near(void const* address) {
  __builtin_prefetch(address);
  asm volatile("");  // else a function that does nothing but this counts as one without effect, and calls are dropped
}

/// Write eight numbers to the start of a cache line that will not be read soon, past the cache where that can be done:
/// the line is not read from memory first, and nothing else is displaced. `stream_end` must follow before others read.
inline void stream(Real* to, Lanes const& values) {
#ifdef __AVX512F__
  _mm512_stream_pd(to, (__m512d)values);
#else
  store(to, values);
#endif
}
inline void stream_end() {
#ifdef __AVX512F__
  _mm_sfence();
#endif
}

/// The values at eight places. One by one: where processors mend the leak of gather instructions, these wait for each
/// other.
inline Lanes pick(Real const* from, LocalIndex const* n) {
  return Lanes{from[n[0]], from[n[1]], from[n[2]], from[n[3]], from[n[4]], from[n[5]], from[n[6]], from[n[7]]};
}

template <class To, class From>
inline To convert(From const& values) {
  return __builtin_convertvector(values, To);
}

/// Write three vectors lane by lane, and a zero after each three numbers.
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

/// One byte per lane, not zero where the comparison of lanes holds.
inline std::uint64_t bytes_of(IndexLanes const& mask) {
  typedef std::int8_t ByteLanes __attribute__((vector_size(lane_count)));
  auto const bytes = convert<ByteLanes>(mask);
  std::uint64_t out;
  std::memcpy(&out, &bytes, sizeof out);
  return out;
}

/// Whether eight places lie side by side, ascending.
inline bool are_consecutive(LocalIndex const* place) {
  constexpr IndexLanes number = {0, 1, 2, 3, 4, 5, 6, 7};
  return bytes_of(load<IndexLanes>(place) == place[0] + number) == ~std::uint64_t(0);
}

// What shapes are made of.

/// The largest whole number that is not above `x`, whose magnitude is below 2^51.
inline Lanes round_down(Lanes const& x) {
  constexpr Real shift = 0x1.8p52;  // sums with it are rounded to whole numbers
  Lanes const nearest = (x + shift) - shift;
  return nearest - (nearest > x ? Lanes{} + 1 : Lanes{});
}

/// Those of eight consecutive places, starting at a multiple of eight, that belong to a run.
struct LaneGroup {
  std::int64_t first;
  int from, to;
  bool whole() const { return from == 0 && to == lane_count; }
};

/// Call f(group) for the groups of a run [first, last).
template <class F>
void for_each_group(std::int64_t first, std::int64_t last, F&& f) {
  for (std::int64_t n = first / lane_count * lane_count; n < last; n += lane_count)
    f(LaneGroup{n, int(std::max<std::int64_t>(0, first - n)), int(std::min<std::int64_t>(lane_count, last - n))});
}

/// Particles that pass through the parts of a kernel together. What one part leaves to the next stays in the
/// first-level cache, and the processor works on many of them at a time, where part after part for each would be one
/// long wait.
constexpr int block_size = 8 * lane_count;

/// Call f(first, last) for consecutive parts of a run [first, last), each within one aligned block.
template <class F>
void for_each_block(std::int64_t first, std::int64_t last, F&& f) {
  while (first < last) {
    std::int64_t const next = std::min(last, (first / block_size + 1) * block_size);
    f(first, next);
    first = next;
  }
}

/// The values of a group; lanes beyond it get one of its own.
inline Lanes load(Real const* values, LaneGroup const& g) {
  if (g.whole()) return load<Lanes>(values + g.first);
  Lanes out{};
  for (int i = 0; i < lane_count; ++i) out[i] = values[g.first + std::max(g.from, std::min(g.to - 1, i))];
  return out;
}

/// Write a group, past the cache if the values are `far` and start on a cache line.
inline void store(Real* values, LaneGroup const& g, Lanes const& from, bool far) {
  if (!g.whole()) {
    for (int i = g.from; i < g.to; ++i) values[g.first + i] = from[i];
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
