// Eight numbers at a time, for formulas that serve eight targets (or eight boxes) in one pass.
#pragma once

#include <cmath>

// How vectors are passed matters between object files built for different processors; here all is inlined.
#pragma GCC diagnostic ignored "-Wpsabi"

namespace amrpic::freespace {

constexpr int lane_count = 8;

/// One cache line of doubles. The compiler splits it into the vectors that the processor has.
typedef double Lanes __attribute__((vector_size(lane_count * sizeof(double))));
/// A comparison of Lanes: all bits set where it holds.
typedef long long LaneMask __attribute__((vector_size(lane_count * sizeof(long long))));

inline Lanes broadcast(double value) { return Lanes{} + value; }

inline double inverse_root(double value) { return 1 / std::sqrt(value); }

/// 1 / sqrt(value) of normal numbers, to two units in the last place: a first guess from the exponent, then Newton's
/// method. A library call per lane would take longer than the formulas that use it.
inline Lanes inverse_root(Lanes const& value) {
  LaneMask bits;
  __builtin_memcpy(&bits, &value, sizeof bits);
  bits = 0x5fe6eb50c7b537a9 - (bits >> 1);
  Lanes out;
  __builtin_memcpy(&out, &bits, sizeof out);
  Lanes const half = 0.5 * value;
  for (int step = 0; step < 4; ++step) out *= 1.5 - half * out * out;
  return out;
}

inline Lanes absolute(Lanes const& value) {
  LaneMask bits;
  __builtin_memcpy(&bits, &value, sizeof bits);
  bits &= 0x7fffffffffffffff;
  Lanes out;
  __builtin_memcpy(&out, &bits, sizeof out);
  return out;
}

/// Bit t is set where the mask holds.
inline unsigned bits_of(LaneMask const& mask) {
  LaneMask bits = mask & LaneMask{1, 2, 4, 8, 16, 32, 64, 128};
  bits |= __builtin_shufflevector(bits, bits, 4, 5, 6, 7, 0, 1, 2, 3);
  bits |= __builtin_shufflevector(bits, bits, 2, 3, 0, 1, 6, 7, 4, 5);
  return unsigned(bits[0] | bits[1]);
}

inline LaneMask mask_of(unsigned bits) {
  LaneMask const weights{1, 2, 4, 8, 16, 32, 64, 128};
  return (weights & (long long)(bits)) != 0;
}

inline double sum_of(Lanes const& v) {
  Lanes const four = v + __builtin_shufflevector(v, v, 4, 5, 6, 7, 0, 1, 2, 3);
  Lanes const two = four + __builtin_shufflevector(four, four, 2, 3, 0, 1, 6, 7, 4, 5);
  return two[0] + two[1];
}

}  // namespace amrpic::freespace
