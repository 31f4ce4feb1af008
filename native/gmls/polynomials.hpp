// Spaces: polynomials in one to three coordinates, as coefficients of monomials, by degree.
#pragma once

#include <array>
#include <vector>

#include "base/types.hpp"

namespace amrpic::gmls {

constexpr int highest_order = 4;
using Powers = std::array<int, 3>;  ///< exponents, or derivatives per axis; zero along axes that there are not

/// The monomials of at most `order`: each but the first is an earlier one times a coordinate.
class Monomials {
 public:
  Monomials(int dimension, int order) : order_(order) {
    for (int degree = 0; degree <= order; ++degree)
      for (int i = degree; i >= 0; --i)
        for (int j = degree - i; j >= 0; --j) {
          Powers const e{i, j, degree - i - j};
          if ((dimension < 2 && e[1] > 0) || (dimension < 3 && e[2] > 0)) continue;
          add(e);
        }
  }

  int count() const { return int(exponents_.size()); }
  int order() const { return order_; }
  std::vector<Powers> const& exponents() const { return exponents_; }

  /// `first` times the monomials at a place u.
  template <class V>
  void evaluate(std::array<V, 3> const& u, V const& first, V* out) const {
    out[0] = first;
    for (int i = 1; i < count(); ++i) out[i] = out[factor_[std::size_t(i)]] * u[std::size_t(axis_[std::size_t(i)])];
  }

 private:
  void add(Powers const& e) {
    int axis = 0, factor = 0;
    if (!exponents_.empty()) {
      while (e[std::size_t(axis)] == 0) ++axis;
      Powers smaller = e;
      --smaller[std::size_t(axis)];
      while (exponents_[std::size_t(factor)] != smaller) ++factor;
    }
    exponents_.push_back(e);
    axis_.push_back(axis);
    factor_.push_back(factor);
  }

  int order_;
  std::vector<Powers> exponents_;
  std::vector<int> axis_, factor_;
};

/// Means over [u - a, u + a] of the r-th derivatives of 1, x, x², … x^order. The even powers of the binomial formula,
/// without the cancellation of the difference quotient, so that a = 0 gives the values at u.
template <class V>
std::array<V, highest_order + 1> means_along_axis(V const& u, V const& a, int derivative, int order) {
  std::array<V, highest_order + 1> power, mean, out;
  power[0] = V{} + 1;
  for (int k = 1; k <= order; ++k) power[std::size_t(k)] = power[std::size_t(k - 1)] * u;
  for (int k = 0; k <= order; ++k) {
    V sum = power[std::size_t(k)], even = V{} + 1;
    Real binomial = 1;
    for (int j = 2; j <= k; j += 2) {
      binomial *= Real((k - j + 2) * (k - j + 1)) / Real((j - 1) * j);
      even = even * a * a;
      sum += (binomial / Real(j + 1)) * even * power[std::size_t(k - j)];
    }
    mean[std::size_t(k)] = sum;
  }
  for (int k = 0; k <= order; ++k) {
    Real falling = k < derivative ? 0 : 1;
    for (int j = 0; j < derivative && k >= derivative; ++j) falling *= Real(k - j);
    out[std::size_t(k)] = falling * mean[std::size_t(k < derivative ? 0 : k - derivative)];
  }
  return out;
}

}  // namespace amrpic::gmls
