// Fields that oscillate, in their own axes.
#pragma once

#include "base/constants.hpp"
#include "external/magnets.hpp"

namespace amrpic::external {

/// E oscillates as cos(ω t + phase) and B as -sin(ω t + phase), so that curl E = -∂B/∂t for amplitudes with
/// curl E = ω B. Without a frequency both are constant.
struct Oscillation {
  Real omega;  ///< 1/s
  Real phase;  ///< rad
  template <class T>
  T of_E(T const& time) const {
    return omega == 0 ? T{} + 1 : cosine(omega * time + phase);
  }
  template <class T>
  T of_B(T const& time) const {
    return omega == 0 ? T{} + 1 : 0 - sine(omega * time + phase);
  }
};

/// On the axis E_z = e(z) = V (315/128) / length (1 - u²)⁴, u = z / half, whose integral is the voltage; near it, with
/// k = ω/c and D = e'' + k² e, E_z = e - r² D/4, E_r = -r e'/2 + r³ D'/16 and B_φ = (k/c) (r e/2 - r³ D/16):
/// div E = 0, and curl E + ∂B/∂t is of order r³.
struct Gap {
  Real voltage;  ///< V
  Real half;     ///< length, m
  Oscillation oscillation;
  static constexpr bool has_edges = false;
  static constexpr bool is_hard() { return false; }
  static constexpr bool electric() { return true; }
  bool magnetic() const { return oscillation.omega != 0; }
};

/// (1 - u²)⁴ by u.
template <class V>
Derivatives<V> bell(V const& u) {
  V const uu = u * u, w = 1 - uu, ww = w * w;
  return {ww * ww, -8 * u * ww * w, 8 * ww * (7 * uu - 1), 48 * u * w * (3 - 7 * uu)};
}

template <class V, class T>
Fields<V> field(Gap const& of, Vector3<V> const& at, T const& time) {
  auto const& [x, y, z] = at;
  Real const h = of.half, k = of.oscillation.omega / speed_of_light, peak = of.voltage * 315 / (256 * h);
  T const E = peak * of.oscillation.of_E(time), B = peak * k / speed_of_light * of.oscillation.of_B(time);
  auto const e = bell<V>(z / h);
  V const first = e.first / h, D = e.second / (h * h) + k * k * e.value,
          D_first = e.third / (h * h * h) + k * k * first;
  V const rr = x * x + y * y, E_r = E * (rr * D_first / 16 - first / 2), B_phi = B * (e.value / 2 - rr * D / 16);
  return {{E_r * x, E_r * y, E * (e.value - rr * D / 4)}, {0 - B_phi * y, B_phi * x, V{}}};
}

/// The mode TM010 of a pillbox: E_z = E0 J0(kr), B_φ = (E0/c) J1(kr), between two plates and up to the radius 2.405/k.
struct Pillbox {
  Real E0;  ///< V/m
  Oscillation oscillation;
  static constexpr bool has_edges = false;
  static constexpr bool is_hard() { return true; }
  static constexpr bool electric() { return true; }
  static constexpr bool magnetic() { return true; }
};

constexpr Real first_zero_of_J0 = 2.404825557695773;

/// J0(s) and 2 J1(s) / s as series in (s/2)²: (-1)^n / (n! (n + order)!), to rounding up to the first zero of J0.
constexpr std::array<Real, 14> bessel_series(int order) {
  std::array<Real, 14> out{1};
  for (int n = 1; n < 14; ++n) out[std::size_t(n)] = -out[std::size_t(n - 1)] / (Real(n) * Real(n + order));
  return out;
}

constexpr auto J0 = bessel_series(0), two_J1 = bessel_series(1);

template <class V, class T>
Fields<V> field(Pillbox const& of, Vector3<V> const& at, T const& time) {
  auto const& [x, y, z] = at;
  Real const half_k = of.oscillation.omega / speed_of_light / 2;
  T const E = of.E0 * of.oscillation.of_E(time), B = of.E0 / speed_of_light * half_k * of.oscillation.of_B(time);
  V const ss = half_k * half_k * (x * x + y * y);
  constexpr Real last = first_zero_of_J0 * first_zero_of_J0 / 4;
  auto const inside = V{} + last >= ss;
  V const bounded = lesser<V>(ss, V{} + last);
  V const E_z = zero_unless<V>(inside, E * polynomial(J0, bounded));
  V const B_phi = zero_unless<V>(inside, B * polynomial(two_J1, bounded));  // over r
  return {{V{}, V{}, E_z}, {0 - B_phi * y, B_phi * x, V{}}};
}

}  // namespace amrpic::external
