#pragma once

#include <cmath>
#include <cstdint>

#include "base/lanes.hpp"

namespace amrpic {

KOKKOS_INLINE_FUNCTION Real inverse_root(Real value) { return 1 / std::sqrt(value); }

/// 1 / sqrt(value) of normal numbers, to two units in the last place: a first guess of the processor and a series, or
/// one from the exponent and Newton's method. A library call per lane would take longer than the formulas that use it.
template <class Vector>
inline Vector inverse_root(Vector const& value) {
  if constexpr (std::is_class_v<Vector>) {
    return {inverse_root(value.low), inverse_root(value.high)};
  } else {
#ifdef AMRPIC_AVX512
    Vector const guess = (Vector)_mm512_maskz_rsqrt14_pd(
        all_lanes, (__m512d)value);  // to 2^-14; the series then leaves its fourth power
    Vector const left = 1 - value * guess * guess;
    return guess + guess * left * (0.5 + left * (0.375 + left * 0.3125));
#else
    // without a sign, for which not all processors shift
    typedef std::uint64_t Bits __attribute__((vector_size(sizeof(Vector))));
    Vector out = (Vector)(0x5fe6eb50c7b537a9 - ((Bits)value >> 1));
    Vector const half = 0.5 * value;
    for (int step = 0; step < 4; ++step) out *= 1.5 - half * out * out;
    return out;
#endif
  }
}

KOKKOS_INLINE_FUNCTION Real reciprocal(Real value) { return 1 / value; }

/// 1 / value of normal numbers, to two units in the last place. Unlike quotients, many are under way at a time.
template <class Vector>
inline Vector reciprocal(Vector const& value) {
  if constexpr (std::is_class_v<Vector>) {
    return {reciprocal(value.low), reciprocal(value.high)};
  } else {
#ifdef AMRPIC_AVX512
    Vector const guess = (Vector)_mm512_maskz_rcp14_pd(all_lanes, (__m512d)value), left = 1 - value * guess,
                 near = guess + guess * left;
    return near + near * (left * left);
#else
    return 1 / value;
#endif
  }
}

}  // namespace amrpic
