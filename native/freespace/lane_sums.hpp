// What the potential of free space does with eight numbers at a time: formulas that serve eight targets (or eight
// boxes) in one pass.
#pragma once

#include "base/lanes.hpp"

namespace amrpic::freespace {

inline Lanes absolute(Lanes const& value) { return select(value < Lanes{}, Lanes{} - value, value); }

/// The sums of lanes that are four apart.
template <class Vector>
inline HalfLanes folded(Vector const& v) {
  if constexpr (std::is_class_v<Vector>)
    return v.low + v.high;
  else
    return __builtin_shufflevector(v, v, 0, 1, 2, 3) + __builtin_shufflevector(v, v, 4, 5, 6, 7);
}

inline double sum_of(Lanes const& v) {
  HalfLanes const four = folded(v);
  return (four[0] + four[2]) + (four[1] + four[3]);
}

}  // namespace amrpic::freespace
