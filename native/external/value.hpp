// What formulas of fields do with a number, or with eight at a time: the same operations in the same order, so that
// both give the same bits. Comparisons give a `bool` or a mask of lanes, which `select` and `any` take.
#pragma once

#include <array>
#include <cmath>
#include <type_traits>

#include "base/lanes.hpp"
#include "base/vector3.hpp"

namespace amrpic {

namespace external {

/// A field of one kind per value, in V/m and T.
template <class V>
struct Fields {
  Vector3<V> E{}, B{};
};

inline bool any(bool which) { return which; }
inline bool any(WideLanes const& which) { return bits_of(which) != 0; }
inline bool all(bool which) { return which; }
inline bool all(WideLanes const& which) { return bits_of(which) == all_lanes; }

template <class V>
V lesser(V const& a, V const& b) {
  return select(a < b, a, b);
}
template <class V>
V greater(V const& a, V const& b) {
  return select(a > b, a, b);
}
template <class V>
V clamped(V const& x, Real low, Real high) {
  return lesser<V>(greater<V>(x, V{} + low), V{} + high);
}
template <class V>
V zero_unless(decltype(V{} < V{}) const& which, V const& x) {
  return select(which, x, V{});
}

template <class V>
Vector3<V> sum(Vector3<V> const& a, Vector3<V> const& b) {
  return {a[0] + b[0], a[1] + b[1], a[2] + b[2]};
}

/// c[0] + c[1] x + c[2] x² + …
template <class V, std::size_t n>
V polynomial(std::array<Real, n> const& c, V const& x) {
  V out = V{} + c[n - 1];
  for (std::size_t i = n - 1; i-- > 0;) out = out * x + c[i];
  return out;
}

/// One number of eight; of one number itself.
inline Real lane(Real x, int) { return x; }
inline Real lane(Lanes const& x, int i) { return x[i]; }

inline Real cosine(Real x) { return std::cos(x); }
inline Real sine(Real x) { return std::sin(x); }
template <class F>
Lanes of_each(Lanes const& x, F const& f) {
  Real values[lane_count];
  for (int i = 0; i < lane_count; ++i) values[i] = f(x[i]);
  return load<Lanes>(values);
}
inline Lanes cosine(Lanes const& x) {
  return of_each(x, [](Real one) { return std::cos(one); });
}
inline Lanes sine(Lanes const& x) {
  return of_each(x, [](Real one) { return std::sin(one); });
}

/// 2^n for whole numbers n between -1022 and 1023.
template <class V>
V power_of_two(V const& n) {
  if constexpr (std::is_same_v<V, Real>) {
    return std::ldexp(1.0, int(n));
  } else if constexpr (std::is_class_v<V>) {
    return {power_of_two(n.low), power_of_two(n.high)};
  } else {
    typedef std::uint64_t Bits __attribute__((vector_size(sizeof(V))));
    V const shifted = n + (0x1.8p52 + 1023);  // the lowest bits of it are those of the exponent
    return (V)((Bits)shifted << 52);
  }
}

/// 1 / n! for n = 0 … 13.
constexpr std::array<Real, 14> inverse_factorials() {
  std::array<Real, 14> out{1};
  Real factorial = 1;
  for (int n = 1; n < 14; ++n) out[std::size_t(n)] = 1 / (factorial *= n);
  return out;
}

constexpr auto exponential_series = inverse_factorials();

/// e^x to some units in the last place; x is taken between -700 and 700.
template <class V>
V exponential(V const& x) {
  constexpr Real log2_e = 1.4426950408889634, ln2_high = 0x1.62e42feep-1, ln2_low = 0x1.a39ef35793c76p-33;
  V const bounded = clamped(x, -700, 700), n = round_down(log2_e * bounded + 0.5);
  V const rest = (bounded - n * ln2_high) - n * ln2_low;  // within ±0.35: fourteen terms reach rounding
  return polynomial(exponential_series, rest) * power_of_two(n);
}

}  // namespace external
}  // namespace amrpic
