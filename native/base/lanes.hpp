// Eight numbers at a time, in GCC's vector types: the compiler splits them into the vectors that the processor has, so
// one text serves all.
#pragma once

#include <array>
#include <cstring>

#include "base/intrinsics.hpp"
#include "base/types.hpp"

// How vectors are passed matters between object files built for different processors; here all is inlined.
#pragma GCC diagnostic ignored "-Wpsabi"

namespace amrpic {

constexpr int lane_count = 8;

typedef Real Lanes __attribute__((vector_size(8 * lane_count)));

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

/// Three vectors lane by lane, and a zero after each three numbers.
inline std::array<Lanes, 4> interleaved(Lanes const& x, Lanes const& y, Lanes const& z) {
  Lanes const xy[2] = {__builtin_shufflevector(x, y, 0, 8, 1, 9, 2, 10, 3, 11),
                       __builtin_shufflevector(x, y, 4, 12, 5, 13, 6, 14, 7, 15)};
  Lanes const z0[2] = {__builtin_shufflevector(z, Lanes{}, 0, 8, 1, 9, 2, 10, 3, 11),
                       __builtin_shufflevector(z, Lanes{}, 4, 12, 5, 13, 6, 14, 7, 15)};
  return {__builtin_shufflevector(xy[0], z0[0], 0, 1, 8, 9, 2, 3, 10, 11),
          __builtin_shufflevector(xy[0], z0[0], 4, 5, 12, 13, 6, 7, 14, 15),
          __builtin_shufflevector(xy[1], z0[1], 0, 1, 8, 9, 2, 3, 10, 11),
          __builtin_shufflevector(xy[1], z0[1], 4, 5, 12, 13, 6, 7, 14, 15)};
}
inline void interleave(Lanes const& x, Lanes const& y, Lanes const& z, Real* out) {
  auto const parts = interleaved(x, y, z);
  for (int n = 0; n < 4; ++n) store(out + lane_count * n, parts[std::size_t(n)]);
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

}  // namespace amrpic
