// Eight particles at a time.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>

#include "base/lanes.hpp"

namespace amrpic {

typedef std::int64_t WideLanes
    __attribute__((vector_size(8 * lane_count)));  ///< also a comparison: all bits set, or none
typedef std::int32_t IndexLanes __attribute__((vector_size(4 * lane_count)));

constexpr IndexLanes index_of_lane = {0, 1, 2, 3, 4, 5, 6, 7};

/// The first `count` of them, or as many as there are lanes; behind those zeros.
template <class Vector, class T>
inline Vector load_up_to(T const* from, std::int64_t count) {
  if (count >= lane_count) return load<Vector>(from);
  Vector out{};
  for (int i = 0; i < count; ++i) out[i] = from[i];
  return out;
}

/// Ask for what lies at an address to be brought into the second-level cache: what is asked for well ahead of its use
/// would not stay in the first one, and displace what is in use there. Any address will do.
inline void bring_near(void const* address) {
  __builtin_prefetch(address, 0, 2);
  asm volatile("");  // else a function that does nothing but this counts as one without effect, and calls are dropped
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

inline Lanes square_root(Lanes const& x) {
#ifdef __AVX512F__
  return (Lanes)_mm512_sqrt_pd((__m512d)x);
#else
  Lanes out;
  for (int i = 0; i < lane_count; ++i) out[i] = std::sqrt(x[i]);
  return out;
#endif
}

/// One byte per lane, not zero where the comparison of lanes holds.
inline std::uint64_t bytes_of(IndexLanes const& mask) {
  typedef std::int8_t ByteLanes __attribute__((vector_size(lane_count)));
  auto const bytes = convert<ByteLanes>(mask);
  std::uint64_t out;
  std::memcpy(&out, &bytes, sizeof out);
  return out;
}

/// One bit per lane, set where the comparison of lanes holds.
inline unsigned bits_of(WideLanes const& mask) {
#ifdef __AVX512DQ__
  return _mm512_movepi64_mask((__m512i)mask);
#else
  constexpr std::uint64_t one_each = 0x0101010101010101, to_top = 0x0102040810204080;
  return unsigned(((bytes_of(convert<IndexLanes>(mask)) & one_each) * to_top) >> 56);
#endif
}

/// Call f(n) for each bit that is set.
template <class Bits, class F>
void for_each_bit(Bits bits, F&& f) {
  for (; bits != 0; bits &= bits - 1) f(__builtin_ctzll(bits));
}

/// Those lanes side by side whose bits are set, and whatever behind them.
#ifdef __AVX512VL__
inline Lanes compressed(unsigned bits, Lanes const& v) {
  return (Lanes)_mm512_maskz_compress_pd(__mmask8(bits), (__m512d)v);
}
inline IndexLanes compressed(unsigned bits, IndexLanes const& v) {
  return (IndexLanes)_mm256_maskz_compress_epi32(__mmask8(bits), (__m256i)v);
}
#else
template <class Vector>
inline Vector compressed(unsigned bits, Vector const& v) {
  Vector out{};
  int n = 0;
  for_each_bit(bits, [&](int i) { out[n++] = v[i]; });
  return out;
}
#endif

/// Eight of the lanes of one vector followed by those of another, from lane n on; n is at most eight.
inline Lanes window(Lanes const& a, Lanes const& b, int n) {
#ifdef __AVX512F__
  constexpr WideLanes one_after_the_other = {0, 1, 2, 3, 4, 5, 6, 7};
  return (Lanes)_mm512_permutex2var_pd((__m512d)a, (__m512i)(one_after_the_other + n), (__m512d)b);
#else
  Real both[2 * lane_count];
  store(both, a);
  store(both + lane_count, b);
  return load<Lanes>(both + n);
#endif
}

/// Write those lanes side by side whose bits are set, and whatever behind them: eight values in all. Return how many.
template <class Vector, class T>
inline int compress(unsigned bits, Vector const& from, T* to) {
  store(to, compressed(bits, from));
  return __builtin_popcount(bits);
}

/// Write those lanes whose bits are set.
inline void store_some(Real* to, unsigned bits, Lanes const& values) {
#ifdef __AVX512F__
  _mm512_mask_storeu_pd(to, __mmask8(bits), (__m512d)values);
#else
  for_each_bit(bits, [&](int i) { to[i] = values[i]; });
#endif
}

// What shapes are made of.

/// The largest whole number that is not above `x`, whose magnitude is below 2^51.
inline Lanes round_down(Lanes const& x) {
#ifdef __AVX512F__
  return (Lanes)_mm512_floor_pd((__m512d)x);
#else
  constexpr Real shift = 0x1.8p52;  // sums with it are rounded to whole numbers
  Lanes const nearest = (x + shift) - shift;
  return nearest - (nearest > x ? Lanes{} + 1 : Lanes{});
#endif
}

constexpr unsigned all_lanes = (1u << lane_count) - 1;

/// Those of eight consecutive places, starting at a multiple of eight, that are meant: a bit for each.
struct LaneGroup {
  std::int64_t first;
  unsigned lanes;
  bool whole() const { return lanes == all_lanes; }
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

/// Call f(group) for the groups of a block of which any place is meant.
template <class F>
inline void for_each_group(LaneBlock const& block, F&& f) {
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
  Lanes out = values[g.first + __builtin_ctz(g.lanes)] + Lanes{};
  for_each_bit(g.lanes, [&](int i) { out[i] = values[g.first + i]; });
  return out;
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
