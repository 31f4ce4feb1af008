// Operators at Gauss's P points along each axis: a matrix along lines, a factor for each point, the matrix's transpose.
#pragma once

#include "fem/at_points.hpp"

namespace amrpic::fem {

/// What is common to all elements.
template <int P>
struct GaussRule {
  Matrix<P> from_nodes = nodes_to_gauss<P>(), to_nodes = transposed(nodes_to_gauss<P>()), slope = slopes_at_gauss<P>(),
            transposed_slope = transposed(slopes_at_gauss<P>());
  std::array<Real, P> weight;

  GaussRule() {
    auto const rule = gauss_rule(P);
    std::copy_n(rule.weight.begin(), P, weight.begin());
  }
};

/// Call f(n, product of the weights of point n).
template <int P, class F>
inline void for_each_gauss_point(GaussRule<P> const& rule, F&& f) {
  for (int k = 0, n = 0; k < P; ++k)
    for (int j = 0; j < P; ++j)
      for (int i = 0; i < P; ++i, ++n)
        f(n, rule.weight[std::size_t(i)] * rule.weight[std::size_t(j)] * rule.weight[std::size_t(k)]);
}

template <int P, int C>
struct MassAtGauss {
  static constexpr bool reads = true, writes = true;
  Real volume;  ///< of the element over that of [-1, 1]^3
  GaussRule<P> rule = {};

  void operator()(LocalIndex const*, int, GroupValues<P, C>& values) const {
    for (int c = 0; c < C; ++c) {
      V* const u = values.value[c];
      transform(rule.from_nodes, u);
      for_each_gauss_point(rule, [&](int n, Real weight) { u[n] *= V{} + volume * weight; });
      transform(rule.to_nodes, u);
    }
  }
};

template <int P, int C>
struct PoissonAtGauss {
  static constexpr bool reads = true, writes = true;
  Real volume;
  Real3 metric;  ///< squares of slopes in space over those in the element
  GaussRule<P> rule = {};

  void operator()(LocalIndex const*, int, GroupValues<P, C>& values) const {
    V sum[P * P * P];
    for (int c = 0; c < C; ++c) {
      V* const u = values.value[c];
      transform(rule.from_nodes, u);
      for (V& s : sum) s = V{};
      for (int axis = 0; axis < 3; ++axis) along(axis, u, sum);
      transform(rule.to_nodes, sum);
      std::copy_n(sum, P * P * P, u);
    }
  }

 private:
  /// Slopes along the lines of an axis, and what they are tested with.
  void along(int axis, V const* u, V* sum) const {
    int const stride = line_stride<P>(axis);
    Real const factor = volume * metric[std::size_t(axis)];
    for (int n = 0; n < P * P; ++n) {
      int const start = line_start<P>(axis, n);
      Real const weight = factor * rule.weight[std::size_t(n % P)] * rule.weight[std::size_t(n / P)];
      V in[P], flux[P];
      for (int l = 0; l < P; ++l) in[l] = u[start + l * stride];
      for (int i = 0; i < P; ++i) {
        V slope = rule.slope[i][0] * in[0];
        for (int l = 1; l < P; ++l) slope += rule.slope[i][l] * in[l];
        flux[i] = slope * (V{} + weight * rule.weight[std::size_t(i)]);
      }
      for (int i = 0; i < P; ++i) {
        V& out = sum[start + i * stride];
        for (int l = 0; l < P; ++l) out += rule.transposed_slope[i][l] * flux[l];
      }
    }
  }
};

/// Any function of slopes at Gauss's points, as in `AtPoints`. Sums along axes have a lane for each element; the
/// function takes blocks of points of one element.
template <int P, int C>
struct SlopesAtGauss {
  static constexpr bool reads = true, writes = true;
  static constexpr int count = P * P * P;

  Points const& points;
  PointFunction<C> d;
  GaussRule<P> rule = {};

  void operator()(LocalIndex const* elements, int lanes, GroupValues<P, C>& values) const;

 private:
  /// The function where one element, a lane, has a block of points.
  void at_block(std::int64_t block, int lane, int first, V (&slope)[C][3][count]) const;
  /// Slopes of u along the lines of an axis; or the transpose, added.
  template <bool back>
  void along(int axis, V const* u, V* out) const;
};

}  // namespace amrpic::fem
