#pragma once

#include <cmath>
#include <cstdint>

#include "base/lanes.hpp"

namespace amrpic {

inline Real inverse_root(Real value) { return 1 / std::sqrt(value); }

/// 1 / sqrt(value) of normal numbers, to two units in the last place: a first guess from the exponent, then Newton's
/// method. A library call per lane would take longer than the formulas that use it.
template <class Vector>
inline Vector inverse_root(Vector const& value) {
  if constexpr (std::is_class_v<Vector>) {
    return {inverse_root(value.low), inverse_root(value.high)};
  } else {
    // without a sign, for which not all processors shift
    typedef std::uint64_t Bits __attribute__((vector_size(sizeof(Vector))));
    Vector out = (Vector)(0x5fe6eb50c7b537a9 - ((Bits)value >> 1));
    Vector const half = 0.5 * value;
    for (int step = 0; step < 4; ++step) out *= 1.5 - half * out * out;
    return out;
  }
}

}  // namespace amrpic
