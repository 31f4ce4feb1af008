// Weights of samples by their distance from the target, in units of the reach, beyond which they vanish.
#pragma once

#include <algorithm>
#include <cmath>

#include "base/inverse_root.hpp"

namespace amrpic::gmls {

enum class WeightKind { power, gaussian, cubic_spline, cardinal_spline, cosine, sigmoid };

struct Weight {
  WeightKind kind = WeightKind::power;
  Real p = 2;  ///< power: outer exponent, whole; gaussian: width; sigmoid: steepness
  Real n = 1;  ///< power: inner exponent, whole; sigmoid: exponent
};

template <class V>
V at_least(V const& a, V const& b) {
  return a > b ? a : b;
}
template <class V>
V magnitude(V const& a) {
  V const opposite = V{} - a;
  return at_least(a, opposite);
}
template <class V>
V root(V const& square) {
  V const safe = at_least(square, V{} + 1e-300);
  return square * inverse_root(safe);
}
template <class V>
V to_power(V const& x, int exponent) {
  V out = V{} + 1;
  for (int k = 0; k < exponent; ++k) out = out * x;
  return out;
}

/// The weight at 0 <= r < 1. Formulas of the Compadre Toolkit's manual (doi 10.11578/dc.20190411.1), each 1 at r = 0.
inline Real weight_inside(Weight const& weight, Real r) {
  switch (weight.kind) {
    case WeightKind::gaussian:
      return std::exp(-r * r / (2 * weight.p * weight.p));
    case WeightKind::cubic_spline: {  // of Hermite: value and slope vanish at the reach, the slope at the target
      return (1 - r) * (1 - r) * (1 + 2 * r);
    }
    case WeightKind::cardinal_spline: {  // knots at 0, 1/2 and 1
      Real const q = 2 * r, outer = 2 - q, inner = std::max(1 - q, 0.0);
      return (outer * outer * outer - 4 * inner * inner * inner) / 4;
    }
    case WeightKind::cosine:
      return std::cos(M_PI / 2 * r);
    case WeightKind::sigmoid: {
      Real const top = 1 / (1 + std::exp(-weight.p));
      return 1 / (1 + std::exp(weight.p * (2 * std::pow(r, weight.n) - 1))) / top;
    }
    default:
      return 0;
  }
}

/// The square root of the weight, of the square of the distance.
template <class V>
V root_of_weight(Weight const& weight, V const& distance_squared) {
  V const r = root(distance_squared);
  if (weight.kind == WeightKind::power) {
    V const inside = at_least(1 - to_power(r, int(weight.n)), V{});
    return int(weight.p) % 2 == 0 ? to_power(inside, int(weight.p) / 2) : root(to_power(inside, int(weight.p)));
  }
  std::array<Real, std::size_t(width<V>)> values;
  store(values.data(), r);
  for (Real& value : values) value = value < 1 ? std::sqrt(weight_inside(weight, value)) : 0;
  return load<V>(values.data());
}

}  // namespace amrpic::gmls
