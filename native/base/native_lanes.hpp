// Vectors as wide as the registers of the processor, for kernels that keep many of them at a time. `Lanes`, always of
// eight numbers, take two registers each with AVX2: twice as many as such kernels have room for.
#pragma once

#include <array>
#include <cstring>

#include "base/lane_types.hpp"

namespace amrpic {

#if defined(AMRPIC_AVX512)
constexpr int native_lane_count = 8;
#elif defined(__AVX2__)
constexpr int native_lane_count = 4;
#else
constexpr int native_lane_count = 2;
#endif

typedef Real NativeLanes __attribute__((vector_size(8 * native_lane_count)));
/// As wide, of twice as many numbers in single precision.
typedef float NativeFloats __attribute__((vector_size(8 * native_lane_count)));
typedef float HalfFloats __attribute__((vector_size(4 * native_lane_count)));

/// The numbers of both.
inline NativeFloats joined(HalfFloats const& a, HalfFloats const& b) {
#if defined(AMRPIC_AVX512)
  return __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
#elif defined(__AVX2__)
  return __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7);
#else
  return __builtin_shufflevector(a, b, 0, 1, 2, 3);
#endif
}

/// The lower and the upper half of the numbers.
inline std::array<HalfFloats, 2> halves(NativeFloats const& v) {
  std::array<HalfFloats, 2> out;
  std::memcpy(&out, &v, sizeof v);
  return out;
}

/// Each lane n is the sum of the lanes of vector n, of as many numbers as `NativeLanes`.
template <class Vector>
inline Vector sums_of_lanes(Vector const* v) {
#if defined(AMRPIC_AVX512)
  auto const pair = [](Vector const& a, Vector const& b) {
    return __builtin_shufflevector(a, b, 0, 8, 2, 10, 4, 12, 6, 14) +
           __builtin_shufflevector(a, b, 1, 9, 3, 11, 5, 13, 7, 15);
  };
  auto const four = [&](Vector const* of) {
    Vector const a = pair(of[0], of[1]), b = pair(of[2], of[3]);
    return __builtin_shufflevector(a, b, 0, 1, 8, 9, 4, 5, 12, 13) +
           __builtin_shufflevector(a, b, 2, 3, 10, 11, 6, 7, 14, 15);
  };
  Vector const a = four(v), b = four(v + 4);
  return __builtin_shufflevector(a, b, 0, 1, 2, 3, 8, 9, 10, 11) +
         __builtin_shufflevector(a, b, 4, 5, 6, 7, 12, 13, 14, 15);
#elif defined(__AVX2__)
  auto const pair = [](Vector const& a, Vector const& b) {
    return __builtin_shufflevector(a, b, 0, 4, 2, 6) + __builtin_shufflevector(a, b, 1, 5, 3, 7);
  };
  Vector const a = pair(v[0], v[1]), b = pair(v[2], v[3]);
  return __builtin_shufflevector(a, b, 0, 1, 4, 5) + __builtin_shufflevector(a, b, 2, 3, 6, 7);
#else
  return __builtin_shufflevector(v[0], v[1], 0, 2) + __builtin_shufflevector(v[0], v[1], 1, 3);
#endif
}

}  // namespace amrpic
