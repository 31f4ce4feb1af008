// Eight numbers in two vectors of four, for processors with AVX2 but without AVX-512; included by base/lanes.hpp. Each
// function is described in base/lanes_in_one.hpp.
#pragma once

#include "base/lane_types.hpp"

namespace amrpic {

template <class T>
struct Halves {
  typedef T Half __attribute__((vector_size(sizeof(T) * lane_count / 2)));
  Half low, high;

  Halves() = default;
  Halves(Halves const& other) : low(other.low), high(other.high) {}  // by vectors, where compilers copy bytes
  Halves& operator=(Halves const& other) {
    low = other.low, high = other.high;
    return *this;
  }
  Halves(T all) : low{all, all, all, all}, high{all, all, all, all} {}
  Halves(Half const& a, Half const& b) : low(a), high(b) {}
  Halves(T a, T b, T c, T d, T e, T f, T g, T h) : low{a, b, c, d}, high{e, f, g, h} {}

  static Halves at(void const* from) {
    return {load<Half>(from), load<Half>(static_cast<char const*>(from) + sizeof(Half))};
  }
  void write(void* to) const {
    store(to, low);
    store(static_cast<char*>(to) + sizeof(Half), high);
  }
  T operator[](int i) const { return (i < 4 ? low : high)[i % 4]; }

  friend Halves operator+(Halves const& a, Halves const& b) { return {a.low + b.low, a.high + b.high}; }
  friend Halves operator-(Halves const& a, Halves const& b) { return {a.low - b.low, a.high - b.high}; }
  friend Halves operator*(Halves const& a, Halves const& b) { return {a.low * b.low, a.high * b.high}; }
  friend Halves operator/(Halves const& a, Halves const& b) { return {a.low / b.low, a.high / b.high}; }
  friend Halves operator&(Halves const& a, Halves const& b) { return {a.low & b.low, a.high & b.high}; }
  Halves& operator+=(Halves const& other) { return *this = *this + other; }
  Halves& operator&=(Halves const& other) { return *this = *this & other; }

  using Mask = Halves<std::int64_t>;
  friend Mask operator<(Halves const& a, Halves const& b) { return {a.low < b.low, a.high < b.high}; }
  friend Mask operator>(Halves const& a, Halves const& b) { return {a.low > b.low, a.high > b.high}; }
  friend Mask operator>=(Halves const& a, Halves const& b) { return {a.low >= b.low, a.high >= b.high}; }
  friend Mask operator==(Halves const& a, Halves const& b) { return {a.low == b.low, a.high == b.high}; }
};

using Lanes = Halves<Real>;
using WideLanes = Halves<std::int64_t>;

inline Lanes joined(HalfLanes const& a, HalfLanes const& b) { return {a, b}; }

// ---- one by one ----

inline Lanes select(WideLanes const& which, Lanes const& yes, Lanes const& no) {
  auto const half = [](auto const& which, HalfLanes const& yes, HalfLanes const& no) {
    return (HalfLanes)_mm256_blendv_pd((__m256d)no, (__m256d)yes, (__m256d)which);
  };
  return {half(which.low, yes.low, no.low), half(which.high, yes.high, no.high)};
}

inline WideLanes mask_of(unsigned bits) {
  WideLanes const bit{1, 2, 4, 8, 16, 32, 64, 128};
  return (WideLanes(bits) & bit) == bit;
}

inline unsigned bits_of(WideLanes const& mask) {
  return unsigned(_mm256_movemask_pd((__m256d)mask.low) | _mm256_movemask_pd((__m256d)mask.high) << 4);
}
inline unsigned bits_of(IndexLanes const& mask) { return unsigned(_mm256_movemask_ps((__m256)mask)); }

inline Lanes square_root(Lanes const& x) {
  return {(HalfLanes)_mm256_sqrt_pd((__m256d)x.low), (HalfLanes)_mm256_sqrt_pd((__m256d)x.high)};
}

inline Lanes round_down(Lanes const& x) {
  return {(HalfLanes)_mm256_floor_pd((__m256d)x.low), (HalfLanes)_mm256_floor_pd((__m256d)x.high)};
}

inline IndexLanes to_index(Lanes const& values) {
  typedef std::int32_t HalfIndex __attribute__((vector_size(16)));
  return __builtin_shufflevector(__builtin_convertvector(values.low, HalfIndex),
                                 __builtin_convertvector(values.high, HalfIndex), 0, 1, 2, 3, 4, 5, 6, 7);
}

// ---- memory ----

inline void stream(Real* to, Lanes const& values) {
  _mm256_stream_pd(to, (__m256d)values.low);
  _mm256_stream_pd(to + 4, (__m256d)values.high);
}
inline void stream_end() { _mm_sfence(); }

inline Lanes load_some(Real const* from, unsigned bits) {
  WideLanes const mask = mask_of(bits);
  return {(HalfLanes)_mm256_maskload_pd(from, (__m256i)mask.low),
          (HalfLanes)_mm256_maskload_pd(from + 4, (__m256i)mask.high)};
}

inline void store_some(Real* to, unsigned bits, Lanes const& values) {
  WideLanes const mask = mask_of(bits);
  _mm256_maskstore_pd(to, (__m256i)mask.low, (__m256d)values.low);
  _mm256_maskstore_pd(to + 4, (__m256i)mask.high, (__m256d)values.high);
}

/// For each four bits, 32-bit parts of those of four numbers whose bits are set, side by side.
struct CompressTable {
  alignas(32) std::int32_t part[16][8] = {};
  constexpr CompressTable() {
    for (int bits = 0; bits < 16; ++bits)
      for (int i = 0, n = 0; i < 4; ++i)
        if (bits >> i & 1) {
          part[bits][n++] = 2 * i;
          part[bits][n++] = 2 * i + 1;
        }
  }
};
inline constexpr CompressTable compress_table;

inline int compress(unsigned bits, Lanes const& from, Real* to) {
  auto const side_by_side = [](HalfLanes const& half, unsigned of) {
    auto const order = load<IndexLanes>(compress_table.part[of]);
    return (HalfLanes)_mm256_permutevar8x32_epi32((__m256i)half, (__m256i)order);
  };
  store(to, side_by_side(from.low, bits & 15));
  store(to + __builtin_popcount(bits & 15), side_by_side(from.high, bits >> 4));
  return __builtin_popcount(bits);
}
inline int compress(unsigned bits, IndexLanes const& from, LocalIndex* to) {
  int n = 0;
  for_each_bit(bits, [&](int i) { to[n++] = from[i]; });
  return n;
}

// ---- to other places ----

inline Lanes interleaved(HalfLanes const& x, HalfLanes const& y) {
  HalfLanes const even = __builtin_shufflevector(x, y, 0, 4, 2, 6), odd = __builtin_shufflevector(x, y, 1, 5, 3, 7);
  return {__builtin_shufflevector(even, odd, 0, 1, 4, 5), __builtin_shufflevector(even, odd, 2, 3, 6, 7)};
}
inline std::array<Lanes, 2> interleaved(Lanes const& x, Lanes const& y) {
  return {interleaved(x.low, y.low), interleaved(x.high, y.high)};
}

/// Rows and columns of four times four numbers exchanged.
inline std::array<HalfLanes, 4> transposed(HalfLanes const& a, HalfLanes const& b, HalfLanes const& c,
                                           HalfLanes const& d) {
  HalfLanes const ab_even = __builtin_shufflevector(a, b, 0, 4, 2, 6),
                  ab_odd = __builtin_shufflevector(a, b, 1, 5, 3, 7),
                  cd_even = __builtin_shufflevector(c, d, 0, 4, 2, 6),
                  cd_odd = __builtin_shufflevector(c, d, 1, 5, 3, 7);
  return {__builtin_shufflevector(ab_even, cd_even, 0, 1, 4, 5), __builtin_shufflevector(ab_odd, cd_odd, 0, 1, 4, 5),
          __builtin_shufflevector(ab_even, cd_even, 2, 3, 6, 7), __builtin_shufflevector(ab_odd, cd_odd, 2, 3, 6, 7)};
}

inline std::array<Lanes, 4> interleaved(Lanes const& x, Lanes const& y, Lanes const& z) {
  auto const a = transposed(x.low, y.low, z.low, HalfLanes{}), b = transposed(x.high, y.high, z.high, HalfLanes{});
  return {Lanes{a[0], a[1]}, Lanes{a[2], a[3]}, Lanes{b[0], b[1]}, Lanes{b[2], b[3]}};
}

inline std::array<HalfLanes, 3> packed(HalfLanes const& x, HalfLanes const& y, HalfLanes const& z) {
  HalfLanes const xy = __builtin_shufflevector(x, y, 0, 4, 2, 6), zx = __builtin_shufflevector(z, x, 0, 5, 2, 7),
                  yz = __builtin_shufflevector(y, z, 1, 5, 3, 7);
  return {__builtin_shufflevector(xy, zx, 0, 1, 4, 5), __builtin_shufflevector(yz, xy, 0, 1, 6, 7),
          __builtin_shufflevector(zx, yz, 2, 3, 6, 7)};
}
inline std::array<Lanes, 3> packed(Lanes const& x, Lanes const& y, Lanes const& z) {
  auto const a = packed(x.low, y.low, z.low), b = packed(x.high, y.high, z.high);
  return {Lanes{a[0], a[1]}, Lanes{a[2], b[0]}, Lanes{b[1], b[2]}};
}

inline std::array<HalfLanes, 3> unpacked(HalfLanes const& a, HalfLanes const& b, HalfLanes const& c) {
  HalfLanes const xy = __builtin_shufflevector(a, b, 0, 1, 6, 7), zx = __builtin_shufflevector(a, c, 2, 3, 4, 5),
                  yz = __builtin_shufflevector(b, c, 0, 1, 6, 7);
  return {__builtin_shufflevector(xy, zx, 0, 5, 2, 7), __builtin_shufflevector(xy, yz, 1, 4, 3, 6),
          __builtin_shufflevector(zx, yz, 0, 5, 2, 7)};
}
inline std::array<Lanes, 3> unpacked(std::array<Lanes, 3> const& of) {
  auto const a = unpacked(of[0].low, of[0].high, of[1].low), b = unpacked(of[1].high, of[2].low, of[2].high);
  return {Lanes{a[0], b[0]}, Lanes{a[1], b[1]}, Lanes{a[2], b[2]}};
}

inline std::array<Lanes, 3> separated(std::array<Lanes, 4> const& of) {
  auto const a = transposed(of[0].low, of[0].high, of[1].low, of[1].high),
             b = transposed(of[2].low, of[2].high, of[3].low, of[3].high);
  return {Lanes{a[0], b[0]}, Lanes{a[1], b[1]}, Lanes{a[2], b[2]}};
}
inline std::array<std::array<Lanes, 3>, 2> separated_halves(std::array<Lanes, 8> const& of) {
  return {separated({joined(of[0].low, of[1].low), joined(of[2].low, of[3].low), joined(of[4].low, of[5].low),
                     joined(of[6].low, of[7].low)}),
          separated({joined(of[0].high, of[1].high), joined(of[2].high, of[3].high), joined(of[4].high, of[5].high),
                     joined(of[6].high, of[7].high)})};
}

}  // namespace amrpic
