// Weights w = V max(least, 1 + A'λ) satisfy the conditions for the nearest ones to V if A w = b. So λ minimises the
// convex function F(λ) = sum of V ψ(1 + A'λ) - b λ, where ψ' = max(least, .), which Newton's method does in few steps,
// as F is made of parabolas. There are no such weights if and only if some polynomial is nowhere negative at points,
// while its integral minus its sum over the least weights is negative: then F has no minimum, and λ goes that way.
#include "fem/moments.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <optional>
#include <utility>

#include "base/large_array.hpp"
#include "base/native_lanes.hpp"

namespace amrpic::fem {

namespace {

constexpr Real exactly = 1e-13;  ///< error of a moment that counts as none; moments of order 1
constexpr int most_steps = 60;

using Array = LargeArray<Real>;

/// Of numbers that fill whole vectors.
Real dot(Real const* a, Real const* b, std::size_t count) {
  NativeLanes sums{};
  for (std::size_t n = 0; n < count; n += native_lane_count)
    sums += load<NativeLanes>(a + n) * load<NativeLanes>(b + n);
  Real out = 0;
  for (int l = 0; l < native_lane_count; ++l) out += sums[l];
  return out;
}

constexpr std::size_t tile = native_lane_count;

/// Products of so many rows with another one, which is read once for all.
NativeLanes dots(Real const* rows, Real const* b, std::size_t count) {
  NativeLanes sums[tile] = {};
  for (std::size_t n = 0; n < count; n += native_lane_count) {
    auto const other = load<NativeLanes>(b + n);
    for (std::size_t r = 0; r < tile; ++r) sums[r] += load<NativeLanes>(rows + r * count + n) * other;
  }
  return sums_of_lanes(sums);
}

/// The least whole vectors that hold so many numbers.
std::size_t padded(std::size_t count) { return (count + tile - 1) / tile * tile; }

/// Square roots of positive definite matrices U'U. Rows, as many as a multiple of a tile, and vectors fill whole
/// vectors of the processor, up with zeros.
class Cholesky {
 public:
  /// Of the upper triangle of `matrix`, which it overwrites; `shift` is added to its diagonal.
  Cholesky(Array& matrix, std::size_t size, Real shift) : u_(matrix.data()), size_(size), stride_(padded(size)) {
    for (std::size_t first = 0; first < size; first += tile) {
      for (std::size_t n = first; n < stride_; n += tile) subtract_rows_before(first, n);
      for (std::size_t k = first; k < std::min(first + tile, size); ++k) {
        Real* const of_pivot = row(k);
        std::fill(of_pivot + first, of_pivot + k, Real(0));
        Real const pivot = of_pivot[k] + shift;
        smallest_pivot_ = std::min(smallest_pivot_, pivot);
        of_pivot[k] = std::sqrt(std::max(pivot, shift));
        Real const by = 1 / of_pivot[k];
        for (std::size_t j = k + 1; j < size; ++j) of_pivot[j] *= by;
        for (std::size_t i = k + 1; i < std::min(first + tile, size); ++i) subtract(row(i), of_pivot[i], of_pivot, i);
      }
    }
  }
  Real smallest_pivot() const { return smallest_pivot_; }

  void solve(std::vector<Real>& b) const {
    for (std::size_t i = 0; i < size_; ++i) {
      Real const own = b[i] / row(i)[i];
      subtract(b.data(), own, row(i), i);
      b[i] = own;
    }
    for (std::size_t i = size_; i-- > 0;) {
      Real const own = std::exchange(b[i], 0);
      std::size_t const from = i / tile * tile;
      b[i] = (own - dot(row(i) + from, b.data() + from, stride_ - from)) / row(i)[i];
    }
  }

 private:
  /// a -= by b, from `first` on, and from up to a vector before.
  void subtract(Real* a, Real by, Real const* b, std::size_t first) const {
    for (std::size_t n = first / tile * tile; n < stride_; n += tile)
      store(a + n, load<NativeLanes>(a + n) - by * load<NativeLanes>(b + n));
  }
  /// From a tile of rows, in the columns of one vector, what all rows before have to do with it.
  void subtract_rows_before(std::size_t first, std::size_t column) const {
    NativeLanes left[tile];
    for (std::size_t r = 0; r < tile; ++r) left[r] = load<NativeLanes>(row(first + r) + column);
    for (std::size_t k = 0; k < first; ++k) {
      auto const there = load<NativeLanes>(row(k) + column);
      for (std::size_t r = 0; r < tile; ++r) left[r] -= row(k)[first + r] * there;
    }
    for (std::size_t r = 0; r < tile; ++r) store(row(first + r) + column, left[r]);
  }
  Real* row(std::size_t i) const { return u_ + i * stride_; }

  Real* u_;
  std::size_t size_, stride_;
  Real smallest_pivot_ = 1e300;
};

/// Legendre's polynomials at points x, with mean square 1.
void legendre_rows(NativeLanes const& x, int highest, NativeLanes* out) {
  NativeLanes before{}, here = before + Real(1);
  for (int n = 0; n <= highest; ++n) {
    out[n] = here * std::sqrt(Real(2 * n + 1));
    NativeLanes const next = (Real(2 * n + 1) * x * here - Real(n) * before) / Real(n + 1);
    before = here, here = next;
  }
}

/// The weights of one element's points, in parts of its volume, that are exact to one degree. Behind the points there
/// are some without volume, where all polynomials are zero, up to whole vectors.
class Fit {
 public:
  Fit(Real const* reference, std::vector<Real> const& volume, std::size_t count, int degree)
      : count_(count),
        points_(volume.size()),
        volume_(volume),
        moments_(std::size_t(degree + 1) * (degree + 1) * (degree + 1)),
        rows_(padded(moments_)) {
    a_.resize(rows_ * points_);
    std::fill(a_.begin() + std::ptrdiff_t(moments_ * points_), a_.end(), Real(0));
    NativeLanes rows[3][16];
    for (std::size_t p = 0; p < count; p += tile) {
      NativeLanes place[3] = {}, one{};  // 1 where there is a point
      for (std::size_t l = 0; l < std::min(tile, count - p); ++l) {
        one[l] = 1;
        for (std::size_t d = 0; d < 3; ++d) place[d][l] = reference[3 * (p + l) + d];
      }
      for (std::size_t d = 0; d < 3; ++d) legendre_rows(place[d], degree, rows[d]);
      std::size_t m = 0;
      for (int k = 0; k <= degree; ++k)
        for (int j = 0; j <= degree; ++j)
          for (int i = 0; i <= degree; ++i) store(&a_[m++ * points_ + p], one * rows[0][i] * rows[1][j] * rows[2][k]);
    }
  }

  /// Whether there are such weights: then `weight` holds them.
  bool find(std::vector<Real>& weight) {
    slope_.assign(points_, 0);
    lambda_.assign(rows_, 0);
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
      auto const change = at_points(direction);
      if (step == 0 && count_ <= moments_) {  // then no other weights are exact but these, if any
        if (determined && below_least(change)) return false;
      }
      if (is_impossible(direction, change) || is_impossible(lambda_, slope_)) return false;
      if (!advance(direction, change, residual)) return false;
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
    std::vector<Real> out(rows_);
    for (std::size_t m = 0; m < moments_; m += tile) store(&out[m], -dots(row(m), weight_.data(), points_));
    out[0] += 1;
    return out;
  }

  /// The step to where the present parabola is least, in place of the residual. Whether all moments are independent
  /// there.
  bool newton(std::vector<Real>& residual) {
    constexpr Real shift = 1e-12, independent = 1e-9;
    std::vector<Real> above(points_);
    for (std::size_t p = 0; p < points_; ++p) above[p] = 1 + slope_[p] > least_weight ? volume_[p] : Real(0);
    if (!root_ || above != above_) {
      above_ = std::move(above);
      h_.assign(rows_ * rows_, 0);
      std::vector<Real> scaled(points_);
      for (std::size_t i = 0; i < moments_; ++i) {
        for (std::size_t p = 0; p < points_; ++p) scaled[p] = above_[p] * row(i)[p];
        for (std::size_t j = i / tile * tile; j < moments_; j += tile)  // the upper triangle, and a little more
          store(&h_[i * rows_ + j], dots(row(j), scaled.data(), points_));
      }
      root_.emplace(h_, moments_, shift);
    }
    root_->solve(residual);
    return root_->smallest_pivot() > independent;
  }

  std::vector<Real> at_points(std::vector<Real> const& polynomial) const {
    std::vector<Real> out(points_, 0);
    for (std::size_t m = 0; m < moments_; ++m) {
      Real const by = polynomial[m];
      for (std::size_t p = 0; p < points_; ++p) out[p] += by * row(m)[p];
    }
    return out;
  }

  static bool below_least(std::vector<Real> const& change) {
    return std::any_of(change.begin(), change.end(), [](Real c) { return 1 + c < least_weight - 1e-9; });
  }

  /// Whether minus this polynomial, of these values at points, plus what makes it positive there, shows that there are
  /// no such weights.
  bool is_impossible(std::vector<Real> const& polynomial, std::vector<Real> const& values) const {
    Real const size = std::sqrt(dot(polynomial.data(), polynomial.data(), rows_));
    if (size == 0) return false;
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

  /// λ goes along a direction, a `change` at points, as far as F falls as it should. Whether it could.
  bool advance(std::vector<Real> const& direction, std::vector<Real> const& change, std::vector<Real> const& residual) {
    Real const falls = dot(direction.data(), residual.data(), rows_);
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

  std::size_t count_, points_;
  std::vector<Real> const& volume_;  ///< in parts of the element's
  std::size_t moments_, rows_;
  Array a_, h_;                                ///< each moment's polynomial at points; second derivatives of F
  std::vector<Real> above_;                    ///< those are of the volumes of points above their least weights
  std::optional<Cholesky> root_;               ///< of h_
  std::vector<Real> slope_, lambda_, weight_;  ///< A'λ at points
};

/// The weights of one element, in parts of its volume, and to which degree they are exact.
int fit(Real const* reference, std::vector<Real> const& volume, std::size_t count, int highest,
        std::vector<Real>& weight) {
  auto const found = [&](int degree) { return Fit(reference, volume, count, degree).find(weight); };
  int reached = (highest + 1) / 2;  // of elements of this degree: most reach it, and few go far beyond
  if (!found(reached)) {
    while (--reached >= 0 && !found(reached)) continue;
    if (reached < 0) weight = volume;
    return reached;
  }
  while (reached < highest && found(reached + 1)) ++reached;
  return reached;
}

}  // namespace

FittedWeights fit_moments(std::vector<std::int64_t> const& first, Real const* reference, Real const* volume,
                          bool const* rough, Real element_volume, int highest) {
  FittedWeights out{{volume, volume + first.back()}, {}};
  std::vector<Real> parts, before, weight;
  Real const* place_before = nullptr;
  int degree = not_fitted;
  for (std::size_t e = 0; e + 1 < first.size(); ++e) {
    out.degree.push_back(not_fitted);
    if (rough[e]) continue;
    std::size_t const count = std::size_t(first[e + 1] - first[e]);
    Real const* const place = reference + 3 * first[e];
    parts.clear();
    Real sum = 0;
    for (std::int64_t p = first[e]; p < first[e + 1]; ++p) {
      parts.push_back(volume[p] / element_volume);
      sum += parts.back();
    }
    parts.resize(padded(count), 0);
    if (std::abs(sum - 1) > full_within) continue;
    bool const same = place_before && parts == before && std::equal(place, place + 3 * count, place_before);
    if (!same) degree = fit(place, parts, count, highest, weight);
    out.degree.back() = degree;
    before = parts, place_before = place;
    for (std::size_t p = 0; p < count; ++p) out.weight[std::size_t(first[e]) + p] = weight[p] * element_volume;
  }
  return out;
}

}  // namespace amrpic::fem
