// Eight numbers in one vector: of AVX-512 if the processor has that, else of the compiler, which splits it into what
// the processor has; included by base/lanes.hpp.
#pragma once

#include <cmath>

#include "base/lane_types.hpp"

namespace amrpic {

typedef Real Lanes __attribute__((vector_size(8 * lane_count)));
typedef std::int64_t WideLanes
    __attribute__((vector_size(8 * lane_count)));  ///< also a comparison: all bits set, or none

inline Lanes joined(HalfLanes const& a, HalfLanes const& b) {
  return __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7);
}

// ---- one by one ----

/// The lanes of `yes` where a comparison holds, else those of `no`.
inline Lanes select(WideLanes const& which, Lanes const& yes, Lanes const& no) { return which ? yes : no; }

/// The largest whole number that is not above `x`, whose magnitude is below 2^51.
inline Lanes round_down(Lanes const& x) {
#ifdef AMRPIC_AVX512
  return (Lanes)_mm512_floor_pd((__m512d)x);
#else
  constexpr Real shift = 0x1.8p52;  // sums with it are rounded to whole numbers
  Lanes const nearest = (x + shift) - shift;
  return nearest - (nearest > x ? Lanes{} + 1 : Lanes{});
#endif
}

/// Whole numbers as such.
inline IndexLanes to_index(Lanes const& values) { return __builtin_convertvector(values, IndexLanes); }

inline Lanes square_root(Lanes const& x) {
#ifdef AMRPIC_AVX512
  return (Lanes)_mm512_maskz_sqrt_pd(all_lanes, (__m512d)x);
#else
  Lanes out;
  for (int i = 0; i < lane_count; ++i) out[i] = std::sqrt(x[i]);
  return out;
#endif
}

// ---- some of them: a bit for each ----

/// The comparison that holds in those lanes whose bits are set.
inline WideLanes mask_of(unsigned bits) {
#ifdef AMRPIC_AVX512
  return (WideLanes)_mm512_movm_epi64(__mmask8(bits));
#else
  constexpr WideLanes bit = {1, 2, 4, 8, 16, 32, 64, 128};
  return ((WideLanes{} + std::int64_t(bits)) & bit) == bit;
#endif
}

/// One bit per lane, set where a comparison holds.
#ifdef AMRPIC_AVX512
inline unsigned bits_of(WideLanes const& mask) { return _mm512_movepi64_mask((__m512i)mask); }
inline unsigned bits_of(IndexLanes const& mask) { return _mm256_movepi32_mask((__m256i)mask); }
#else
inline unsigned bits_of(IndexLanes const& mask) {
  typedef std::int8_t ByteLanes __attribute__((vector_size(lane_count)));
  constexpr std::uint64_t one_each = 0x0101010101010101, to_top = 0x0102040810204080;
  auto const bytes = __builtin_convertvector(mask, ByteLanes);
  return unsigned(((load<std::uint64_t>(&bytes) & one_each) * to_top) >> 56);
}
inline unsigned bits_of(WideLanes const& mask) { return bits_of(__builtin_convertvector(mask, IndexLanes)); }
#endif

/// Read those numbers whose bits are set; zeros for the others.
inline Lanes load_some(Real const* from, unsigned bits) {
#ifdef AMRPIC_AVX512
  return (Lanes)_mm512_maskz_loadu_pd(__mmask8(bits), from);
#else
  Lanes out{};
  for_each_bit(bits, [&](int i) { out[i] = from[i]; });
  return out;
#endif
}

/// Write those lanes whose bits are set.
inline void store_some(Real* to, unsigned bits, Lanes const& values) {
#ifdef AMRPIC_AVX512
  _mm512_mask_storeu_pd(to, __mmask8(bits), (__m512d)values);
#else
  for_each_bit(bits, [&](int i) { to[i] = values[i]; });
#endif
}

/// Write those lanes side by side whose bits are set, and whatever behind them: up to eight values in all. Return how
/// many bits are set.
#ifdef AMRPIC_AVX512
inline int compress(unsigned bits, Lanes const& from, Real* to) {
  store(to, (Lanes)_mm512_maskz_compress_pd(__mmask8(bits), (__m512d)from));
  return __builtin_popcount(bits);
}
inline int compress(unsigned bits, IndexLanes const& from, LocalIndex* to) {
  store(to, (IndexLanes)_mm256_maskz_compress_epi32(__mmask8(bits), (__m256i)from));
  return __builtin_popcount(bits);
}
#else
template <class Vector, class T>
inline int compress(unsigned bits, Vector const& from, T* to) {
  int n = 0;
  for_each_bit(bits, [&](int i) { to[n++] = from[i]; });
  return n;
}
#endif

// ---- past the cache ----

/// Write eight numbers to the start of a cache line that will not be read soon, past the cache where that can be done:
/// the line is not read from memory first, and nothing else is displaced. `stream_end` must follow before others read.
inline void stream(Real* to, Lanes const& values) {
#ifdef AMRPIC_AVX512
  _mm512_stream_pd(to, (__m512d)values);
#else
  store(to, values);
#endif
}
inline void stream_end() {
#ifdef AMRPIC_AVX512
  _mm_sfence();
#endif
}

// ---- to other places ----

/// Two vectors lane by lane.
inline std::array<Lanes, 2> interleaved(Lanes const& x, Lanes const& y) {
  return {__builtin_shufflevector(x, y, 0, 8, 1, 9, 2, 10, 3, 11),
          __builtin_shufflevector(x, y, 4, 12, 5, 13, 6, 14, 7, 15)};
}

/// Three vectors lane by lane, and a zero after each three numbers.
inline std::array<Lanes, 4> interleaved(Lanes const& x, Lanes const& y, Lanes const& z) {
  auto const xy = interleaved(x, y), z0 = interleaved(z, Lanes{});
  return {__builtin_shufflevector(xy[0], z0[0], 0, 1, 8, 9, 2, 3, 10, 11),
          __builtin_shufflevector(xy[0], z0[0], 4, 5, 12, 13, 6, 7, 14, 15),
          __builtin_shufflevector(xy[1], z0[1], 0, 1, 8, 9, 2, 3, 10, 11),
          __builtin_shufflevector(xy[1], z0[1], 4, 5, 12, 13, 6, 7, 14, 15)};
}

/// Three vectors lane by lane.
inline std::array<Lanes, 3> packed(Lanes const& x, Lanes const& y, Lanes const& z) {
  Lanes const xy[3] = {__builtin_shufflevector(x, y, 0, 8, -1, 1, 9, -1, 2, 10),
                       __builtin_shufflevector(x, y, -1, 3, 11, -1, 4, 12, -1, 5),
                       __builtin_shufflevector(x, y, 13, -1, 6, 14, -1, 7, 15, -1)};
  return {__builtin_shufflevector(xy[0], z, 0, 1, 8, 3, 4, 9, 6, 7),
          __builtin_shufflevector(xy[1], z, 10, 1, 2, 11, 4, 5, 12, 7),
          __builtin_shufflevector(xy[2], z, 0, 13, 2, 3, 14, 5, 6, 15)};
}

/// The opposite.
inline std::array<Lanes, 3> unpacked(std::array<Lanes, 3> const& of) {
  Lanes const x = __builtin_shufflevector(of[0], of[1], 0, 3, 6, 9, 12, 15, -1, -1),
              y = __builtin_shufflevector(of[0], of[1], 1, 4, 7, 10, 13, -1, -1, -1),
              z = __builtin_shufflevector(of[0], of[1], 2, 5, 8, 11, 14, -1, -1, -1);
  return {__builtin_shufflevector(x, of[2], 0, 1, 2, 3, 4, 5, 10, 13),
          __builtin_shufflevector(y, of[2], 0, 1, 2, 3, 4, 8, 11, 14),
          __builtin_shufflevector(z, of[2], 0, 1, 2, 3, 4, 9, 12, 15)};
}

/// The first three of each four numbers.
inline std::array<Lanes, 3> separated(std::array<Lanes, 4> const& of) {
  Lanes xy[2], z[2];
  for (std::size_t h = 0; h < 2; ++h) {
    xy[h] = __builtin_shufflevector(of[2 * h], of[2 * h + 1], 0, 4, 8, 12, 1, 5, 9, 13);
    z[h] = __builtin_shufflevector(of[2 * h], of[2 * h + 1], 2, 6, 10, 14, 3, 7, 11, 15);
  }
  return {__builtin_shufflevector(xy[0], xy[1], 0, 1, 2, 3, 8, 9, 10, 11),
          __builtin_shufflevector(xy[0], xy[1], 4, 5, 6, 7, 12, 13, 14, 15),
          __builtin_shufflevector(z[0], z[1], 0, 1, 2, 3, 8, 9, 10, 11)};
}

/// The same of the first halves of eight vectors, and of the second ones.
inline std::array<std::array<Lanes, 3>, 2> separated_halves(std::array<Lanes, 8> const& of) {
  std::array<Lanes, 3> four[2];  // of four vectors each: a component in their first halves, then in their second ones
  for (std::size_t h = 0; h < 2; ++h) {
    Lanes const* const from = &of[4 * h];
    Lanes xz[2], y[2];
    for (int p = 0; p < 2; ++p) {
      xz[p] = __builtin_shufflevector(from[2 * p], from[2 * p + 1], 0, 8, 2, 10, 4, 12, 6, 14);
      y[p] = __builtin_shufflevector(from[2 * p], from[2 * p + 1], 1, 9, 3, 11, 5, 13, 7, 15);
    }
    four[h] = {__builtin_shufflevector(xz[0], xz[1], 0, 1, 8, 9, 4, 5, 12, 13),
               __builtin_shufflevector(y[0], y[1], 0, 1, 8, 9, 4, 5, 12, 13),
               __builtin_shufflevector(xz[0], xz[1], 2, 3, 10, 11, 6, 7, 14, 15)};
  }
  std::array<std::array<Lanes, 3>, 2> out;
  for (std::size_t d = 0; d < 3; ++d) {
    out[0][d] = __builtin_shufflevector(four[0][d], four[1][d], 0, 1, 2, 3, 8, 9, 10, 11);
    out[1][d] = __builtin_shufflevector(four[0][d], four[1][d], 4, 5, 6, 7, 12, 13, 14, 15);
  }
  return out;
}

}  // namespace amrpic
