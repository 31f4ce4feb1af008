// Weights w = V max(least, 1 + A'λ) satisfy the conditions for the nearest ones to V if A w = b. So λ minimises the
// convex function F(λ) = sum of V ψ(1 + A'λ) - b λ, where ψ' = max(least, .), which Newton's method does in few steps,
// as F is made of parabolas. There are no such weights if and only if some polynomial is nowhere negative at points,
// while its integral minus its sum over the least weights is negative: then F has no minimum, and λ goes that way.
#include "fem/moments.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "base/large_array.hpp"
#include "base/native_lanes.hpp"

namespace amrpic::fem {

namespace {

constexpr Real exactly = 1e-13;  ///< error of a moment that counts as none; moments of order 1
constexpr int most_steps = 60;

using Array = LargeArray<Real>;

Real dot(Real const* a, Real const* b, std::size_t count) {
  NativeLanes sums{};
  std::size_t n = 0;
  for (; n + native_lane_count <= count; n += native_lane_count)
    sums += load<NativeLanes>(a + n) * load<NativeLanes>(b + n);
  Real out = 0;
  for (int l = 0; l < native_lane_count; ++l) out += sums[l];
  for (; n < count; ++n) out += a[n] * b[n];
  return out;
}

constexpr std::size_t tile = 4;

/// Products of so many rows with another one, which is read once for all.
std::array<Real, tile> dots(Real const* rows, Real const* b, std::size_t count) {
  NativeLanes sums[tile] = {};
  std::size_t n = 0;
  for (; n + native_lane_count <= count; n += native_lane_count) {
    auto const other = load<NativeLanes>(b + n);
    for (std::size_t r = 0; r < tile; ++r) sums[r] += load<NativeLanes>(rows + r * count + n) * other;
  }
  std::array<Real, tile> out{};
  for (std::size_t r = 0; r < tile; ++r) {
    for (int l = 0; l < native_lane_count; ++l) out[r] += sums[r][l];
    for (std::size_t rest = n; rest < count; ++rest) out[r] += rows[r * count + rest] * b[rest];
  }
  return out;
}

/// Square roots of positive definite matrices, rows of the lower triangle.
class Cholesky {
 public:
  /// Of `matrix`, which it overwrites; `shift` is added to its diagonal.
  Cholesky(Array& matrix, std::size_t size, Real shift) : l_(matrix.data()), size_(size) {
    for (std::size_t i = 0; i < size; ++i) {
      for (std::size_t j = 0; j < i; ++j) at(i, j) = (at(i, j) - dot(row(i), row(j), j)) / at(j, j);
      Real const pivot = at(i, i) + shift - dot(row(i), row(i), i);
      smallest_pivot_ = std::min(smallest_pivot_, pivot);
      at(i, i) = std::sqrt(std::max(pivot, shift));
    }
  }
  Real smallest_pivot() const { return smallest_pivot_; }

  void solve(std::vector<Real>& b) const {
    for (std::size_t i = 0; i < size_; ++i) b[i] = (b[i] - dot(row(i), b.data(), i)) / at(i, i);
    for (std::size_t i = size_; i-- > 0;) {
      b[i] /= at(i, i);
      for (std::size_t j = 0; j < i; ++j) b[j] -= at(i, j) * b[i];
    }
  }

 private:
  Real* row(std::size_t i) const { return l_ + i * size_; }
  Real& at(std::size_t i, std::size_t j) const { return l_[i * size_ + j]; }

  Real* l_;
  std::size_t size_;
  Real smallest_pivot_ = 1e300;
};

/// Legendre's polynomials at x, with mean square 1.
void legendre_row(Real x, int highest, Real* out) {
  Real before = 0, here = 1;
  for (int n = 0; n <= highest; ++n) {
    out[n] = here * std::sqrt(Real(2 * n + 1));
    Real const next = ((2 * n + 1) * x * here - n * before) / (n + 1);
    before = here, here = next;
  }
}

/// The weights of one element's points, in parts of its volume, that are exact to one degree.
class Fit {
 public:
  Fit(Real const* reference, std::vector<Real> const& volume, int degree)
      : points_(volume.size()), volume_(volume), moments_(std::size_t(degree + 1) * (degree + 1) * (degree + 1)) {
    a_.resize(moments_ * points_);
    Real rows[3][16];
    for (std::size_t p = 0; p < points_; ++p) {
      for (int d = 0; d < 3; ++d) legendre_row(reference[3 * p + std::size_t(d)], degree, rows[d]);
      std::size_t m = 0;
      for (int k = 0; k <= degree; ++k)
        for (int j = 0; j <= degree; ++j)
          for (int i = 0; i <= degree; ++i) a_[m++ * points_ + p] = rows[0][i] * rows[1][j] * rows[2][k];
    }
  }

  /// Whether there are such weights: then `weight` holds them.
  bool find(std::vector<Real>& weight) {
    slope_.assign(points_, 0);
    lambda_.assign(moments_, 0);
    set_weights();
    for (int step = 0; step < most_steps; ++step) {
      auto const residual = missing();
      Real largest = 0;
      for (Real r : residual) largest = std::max(largest, std::abs(r));
      if (largest <= exactly) {
        weight = weight_;
        return true;
      }
      auto direction = residual;
      bool const determined = newton(direction);
      if (step == 0 && points_ <= moments_) {  // then no other weights are exact but these, if any
        if (determined && below_least(direction)) return false;
      }
      if (is_impossible(direction) || is_impossible(lambda_)) return false;
      if (!advance(direction, residual)) return false;
    }
    return false;
  }

 private:
  Real const* row(std::size_t m) const { return a_.data() + m * points_; }

  void set_weights() {
    weight_.resize(points_);
    for (std::size_t p = 0; p < points_; ++p) weight_[p] = volume_[p] * std::max(least_weight, 1 + slope_[p]);
  }

  /// b - A w: of all means but that of 1 none is there.
  std::vector<Real> missing() const {
    std::vector<Real> out(moments_);
    for (std::size_t m = 0; m < moments_; ++m) out[m] = (m == 0 ? 1 : 0) - dot(row(m), weight_.data(), points_);
    return out;
  }

  /// The step to where the present parabola is least, in place of the residual. Whether all moments are independent
  /// there.
  bool newton(std::vector<Real>& residual) {
    constexpr Real shift = 1e-12, independent = 1e-9;
    h_.resize(moments_ * moments_);
    std::vector<Real> scaled(tile * points_);
    for (std::size_t i = 0; i < moments_; i += tile) {
      std::size_t const rows = std::min(tile, moments_ - i);
      for (std::size_t r = 0; r < rows; ++r)
        for (std::size_t p = 0; p < points_; ++p)
          scaled[r * points_ + p] = 1 + slope_[p] > least_weight ? volume_[p] * row(i + r)[p] : Real(0);
      for (std::size_t j = 0; j < i + rows; ++j) {  // the lower triangle, and a little more
        auto const products = dots(scaled.data(), row(j), points_);
        for (std::size_t r = 0; r < rows; ++r) h_[(i + r) * moments_ + j] = products[r];
      }
    }
    Cholesky const root(h_, moments_, shift);
    root.solve(residual);
    return root.smallest_pivot() > independent;
  }

  std::vector<Real> at_points(std::vector<Real> const& polynomial) const {
    std::vector<Real> out(points_, 0);
    for (std::size_t m = 0; m < moments_; ++m)
      for (std::size_t p = 0; p < points_; ++p) out[p] += polynomial[m] * row(m)[p];
    return out;
  }

  bool below_least(std::vector<Real> const& step) const {
    auto const change = at_points(step);
    return std::any_of(change.begin(), change.end(), [](Real c) { return 1 + c < least_weight - 1e-9; });
  }

  /// Whether minus this polynomial, plus what makes it positive at points, shows that there are no such weights.
  bool is_impossible(std::vector<Real> const& polynomial) const {
    Real const size = std::sqrt(dot(polynomial.data(), polynomial.data(), moments_));
    if (size == 0) return false;
    auto const values = at_points(polynomial);
    Real const lift = std::max(Real(0), *std::max_element(values.begin(), values.end()));
    Real least_sum = 0;
    for (std::size_t p = 0; p < points_; ++p) {
      least_sum += least_weight * volume_[p] * (lift - values[p]);
    }
    return lift - polynomial[0] - least_sum < -1e-10 * size;
  }

  /// F at the present λ plus a step, without what does not change.
  Real objective(std::vector<Real> const& change, Real step, Real along_b) const {
    Real out = -step * along_b;
    for (std::size_t p = 0; p < points_; ++p) {
      Real const t = 1 + slope_[p] + step * change[p];
      out += volume_[p] * (t > least_weight ? t * t / 2 : least_weight * t - least_weight * least_weight / 2);
    }
    return out;
  }

  /// λ goes along a direction, as far as F falls as it should. Whether it could.
  bool advance(std::vector<Real> const& direction, std::vector<Real> const& residual) {
    auto const change = at_points(direction);
    Real const falls = dot(direction.data(), residual.data(), moments_);
    Real const before = objective(change, 0, direction[0]);
    for (Real step = 1; step > 1e-10; step /= 2) {
      if (objective(change, step, direction[0]) > before - 1e-4 * step * falls + 1e-15 * std::abs(before)) continue;
      for (std::size_t p = 0; p < points_; ++p) slope_[p] += step * change[p];
      for (std::size_t m = 0; m < moments_; ++m) lambda_[m] += step * direction[m];
      set_weights();
      return true;
    }
    return false;
  }

  std::size_t points_;
  std::vector<Real> const& volume_;  ///< in parts of the element's
  std::size_t moments_;
  Array a_, h_;                                ///< each moment's polynomial at points; second derivatives of F
  std::vector<Real> slope_, lambda_, weight_;  ///< A'λ at points
};

/// The weights of one element, in parts of its volume, and to which degree they are exact.
int fit(Real const* reference, std::vector<Real> const& volume, int highest, std::vector<Real>& weight) {
  int reached = not_fitted;
  weight = volume;
  for (int degree = 0; degree <= highest; ++degree) {
    if (!Fit(reference, volume, degree).find(weight)) break;
    reached = degree;
  }
  return reached;
}

}  // namespace

FittedWeights fit_moments(std::vector<std::int64_t> const& first, Real const* reference, Real const* volume,
                          Real element_volume, int highest) {
  FittedWeights out{{volume, volume + first.back()}, {}};
  std::vector<Real> parts, before, weight;
  Real const* place_before = nullptr;
  int degree = not_fitted;
  for (std::size_t e = 0; e + 1 < first.size(); ++e) {
    std::size_t const count = std::size_t(first[e + 1] - first[e]);
    Real const* const place = reference + 3 * first[e];
    parts.clear();
    Real sum = 0;
    for (std::int64_t p = first[e]; p < first[e + 1]; ++p) {
      parts.push_back(volume[p] / element_volume);
      sum += parts.back();
    }
    out.degree.push_back(not_fitted);
    if (std::abs(sum - 1) > full_within) continue;
    bool const same = place_before && parts == before && std::equal(place, place + 3 * count, place_before);
    if (!same) degree = fit(place, parts, highest, weight);
    out.degree.back() = degree;
    before = parts, place_before = place;
    for (std::size_t p = 0; p < count; ++p) out.weight[std::size_t(first[e]) + p] = weight[p] * element_volume;
  }
  return out;
}

}  // namespace amrpic::fem
