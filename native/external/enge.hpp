// Enge's profile of a magnet along its axis (H. A. Enge, Rev. Sci. Instrum. 35, 278 (1964)).
#pragma once

#include "external/value.hpp"

namespace amrpic::external {

/// A function of z and its first three derivatives.
template <class V>
struct Derivatives {
  V value, first, second, third;
};

/// The fringe at both ends of a magnet; without one its edges are hard.
struct Enge {
  Real gap;                         ///< m; 0 for hard edges
  std::array<Real, 6> coefficient;  ///< of the polynomial in s / gap, s being the distance outwards from the end
  Real reach;                       ///< in gaps: beyond it the profile counts as 0, or 1 inside

  bool hard() const { return gap == 0; }
};

/// F(s) = 1 / (1 + e^p(s / gap)), which falls from 1 to 0.
template <class V>
Derivatives<V> fall_off(Enge const& enge, V const& s) {
  auto const& c = enge.coefficient;
  V const u = clamped(s / enge.gap, -enge.reach, enge.reach);
  V const p1 = polynomial(std::array<Real, 5>{c[1], 2 * c[2], 3 * c[3], 4 * c[4], 5 * c[5]}, u) / enge.gap;
  V const p2 = polynomial(std::array<Real, 4>{2 * c[2], 6 * c[3], 12 * c[4], 20 * c[5]}, u) / (enge.gap * enge.gap);
  V const p3 = polynomial(std::array<Real, 3>{6 * c[3], 24 * c[4], 60 * c[5]}, u) / (enge.gap * enge.gap * enge.gap);
  V const e = exponential(polynomial(c, u)), F = 1 / (1 + e);
  // by p: F' = -g, F'' = g (1 - 2 F), F''' = -g (1 - 6 g)
  V const g = (e * F) * F, g2 = g * (1 - 2 * F), g3 = g * (6 * g - 1);
  return {F, 0 - g * p1, g2 * p1 * p1 - g * p2, g3 * p1 * p1 * p1 + 3 * g2 * p1 * p2 - g * p3};
}

/// About 1 between the ends at ± half, and 0 outside.
template <class V>
Derivatives<V> profile(Enge const& enge, Real half, V const& z) {
  Derivatives<V> const out = fall_off<V>(enge, z - half), in = fall_off<V>(enge, V{} - half - z);
  return {out.value + in.value - 1, out.first - in.first, out.second + in.second, out.third - in.third};
}

}  // namespace amrpic::external
