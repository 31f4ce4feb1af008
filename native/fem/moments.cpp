// Weights w = V max(least, 1 + A'λ) satisfy the conditions for the nearest ones to V if A w = b. So λ minimises the
// convex function F(λ) = sum of V ψ(1 + A'λ) - b λ, where ψ' = max(least, .), which Newton's method does in few steps,
// as F is made of parabolas. There are no such weights if and only if some polynomial is nowhere negative at points,
// while its integral minus its sum over the least weights is negative: then F has no minimum, and λ goes that way.
#include "fem/moments.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <optional>
#include <utility>

#include "fem/dense_systems.hpp"

namespace amrpic::fem {

namespace {

constexpr Real exactly = 1e-13;  ///< error of a moment that counts as none; moments of order 1
constexpr int most_steps = 60, most_descents = 12;

/// The largest of numbers that are positive, or zero.
Real largest_or_zero(Real const* a, std::size_t count) {
  NativeLanes out{};
  for (std::size_t n = 0; n < count; n += native_lane_count) {
    auto const here = load<NativeLanes>(a + n);
    out = here > out ? here : out;
  }
  return *std::max_element(&out[0], &out[0] + native_lane_count);
}

constexpr int most_rows = 16;

/// Legendre's polynomials at points x, with mean square 1.
void legendre_rows(NativeLanes const& x, int highest, NativeLanes* out) {
  static auto const sizes = [] {
    std::array<Real, most_rows> roots;
    for (int n = 0; n < most_rows; ++n) roots[std::size_t(n)] = std::sqrt(Real(2 * n + 1));
    return roots;
  }();
  NativeLanes before{}, here = before + Real(1);
  for (int n = 0; n <= highest; ++n) {
    out[n] = here * sizes[std::size_t(n)];
    NativeLanes const next = Real(2 * n + 1) / Real(n + 1) * x * here - Real(n) / Real(n + 1) * before;
    before = here, here = next;
  }
}

/// The weights of one element's points, in parts of its volume, that are exact to one degree. Behind the points there
/// are some without volume, where all polynomials are zero, up to whole vectors.
class Fit {
 public:
  Fit(Real const* reference, std::vector<Real> const& volume, std::size_t count, int degree)
      : points_(volume.size()),
        volume_(volume),
        moments_(std::size_t(degree + 1) * (degree + 1) * (degree + 1)),
        rows_(padded(moments_)) {
    a_.resize(rows_ * points_);
    std::fill(a_.begin() + std::ptrdiff_t(moments_ * points_), a_.end(), Real(0));
    NativeLanes rows[3][most_rows];
    for (std::size_t p = 0; p < count; p += tile) {
      NativeLanes place[3] = {}, one{};  // 1 where there is a point
      for (std::size_t l = 0; l < std::min(tile, count - p); ++l) {
        one[l] = 1;
        for (std::size_t d = 0; d < 3; ++d) place[d][l] = reference[3 * (p + l) + d];
      }
      for (std::size_t d = 0; d < 3; ++d) legendre_rows(place[d], degree, rows[d]);
      std::size_t m = 0;
      for (int k = 0; k <= degree; ++k)
        for (int j = 0; j <= degree; ++j) {
          auto const other = one * rows[1][j] * rows[2][k];
          for (int i = 0; i <= degree; ++i) store(&a_[m++ * points_ + p], other * rows[0][i]);
        }
    }
  }

  /// Whether there are such weights: then `weight` holds them. That there are none is found sooner if that is thought
  /// of.
  bool find(std::vector<Real>& weight, bool doubtful) {
    if (doubtful && descends_for_ever()) return false;
    begin();  // Newton's method would go astray from where that led
    for (int step = 0; step < most_steps; ++step) {
      auto const residual = missing();
      Real largest = 0;
      for (Real r : residual) largest = std::max(largest, std::abs(r));
      if (largest <= exactly) {
        weight = weight_;
        return true;
      }
      auto direction = residual;
      newton(direction);
      auto const change = at_points(direction);
      if (is_impossible(direction, change) || is_impossible(lambda_, slope_)) return false;
      if (!advance(direction, change, residual)) return false;
    }
    return false;
  }

 private:
  Real const* row(std::size_t m) const { return a_.data() + m * points_; }

  /// Whether steps of conjugate gradients down F show that it has no minimum, which they do soon if few weights that
  /// are exact would be positive.
  bool descends_for_ever() {
    begin();
    auto residual = missing(), direction = residual;
    for (int step = 0; step < most_descents; ++step) {
      auto const change = at_points(direction);
      Real const length = to_minimum(change, direction[0]);
      if (length == 0) return false;
      go(length, direction, change);
      if (is_impossible(lambda_, slope_)) return true;
      auto const next = missing();
      Real const kept = dot(next.data(), next.data(), rows_) / dot(residual.data(), residual.data(), rows_);
      for (std::size_t m = 0; m < moments_; ++m) direction[m] = next[m] + kept * direction[m];
      residual = next;
    }
    return false;
  }

  /// The step to where F is least along a direction, nearly: it is made of parabolas.
  Real to_minimum(std::vector<Real> const& change, Real along_b) const {
    Real out = 0;
    for (int parabola = 0; parabola < 3; ++parabola) {
      NativeLanes slopes{}, curvatures{};
      for (std::size_t p = 0; p < points_; p += tile) {
        auto const by = load<NativeLanes>(&change[p]), t = 1 + load<NativeLanes>(&slope_[p]) + out * by;
        auto const of_volume = load<NativeLanes>(&volume_[p]) * by;
        slopes += of_volume * (t > least_weight ? t : NativeLanes{} + least_weight);
        curvatures += t > least_weight ? of_volume * by : NativeLanes{};
      }
      Real const curvature = sum_of_lanes(curvatures);
      if (!(curvature > 0)) break;
      out -= (sum_of_lanes(slopes) - along_b) / curvature;
    }
    return out;
  }

  void begin() {
    slope_.assign(points_, 0);
    lambda_.assign(rows_, 0);
    set_weights();
  }

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

  /// The step to where the present parabola is least, in place of the residual.
  void newton(std::vector<Real>& residual) {
    constexpr Real shift = 1e-12;
    std::vector<Real> above(points_);
    for (std::size_t p = 0; p < points_; ++p) above[p] = 1 + slope_[p] > least_weight ? volume_[p] : Real(0);
    if (!root_ || above != above_) {
      find_second_derivatives(above);
      above_ = std::move(above);
      of_root_ = h_;
      root_.emplace(of_root_, moments_, shift);
    }
    root_->solve(residual);
  }

  /// The upper triangle of h_, and a little more, of points of these volumes: from what it was, where few have others.
  void find_second_derivatives(std::vector<Real> const& above) {
    std::vector<std::size_t> others;
    for (std::size_t p = 0; root_ && p < points_; ++p)
      if (above[p] != above_[p]) others.push_back(p);
    if (!root_ || tile * others.size() > points_) {
      h_.assign(rows_ * rows_, 0);
      std::vector<Real> scaled(points_);
      for (std::size_t i = 0; i < moments_; ++i) {
        for (std::size_t p = 0; p < points_; ++p) scaled[p] = above[p] * row(i)[p];
        for (std::size_t j = i / tile * tile; j < moments_; j += tile)
          store(&h_[i * rows_ + j], dots(row(j), scaled.data(), points_));
      }
      return;
    }
    std::vector<Real> here(rows_);
    for (std::size_t const p : others) {
      for (std::size_t m = 0; m < moments_; ++m) here[m] = row(m)[p];
      for (std::size_t i = 0; i < moments_; ++i) {
        Real const by = (above[p] - above_[p]) * here[i];
        for (std::size_t j = i / tile * tile; j < rows_; j += tile)
          store(&h_[i * rows_ + j], load<NativeLanes>(&h_[i * rows_ + j]) + by * load<NativeLanes>(&here[j]));
      }
    }
  }

  std::vector<Real> at_points(std::vector<Real> const& polynomial) const {
    std::vector<Real> out(points_);
    for (std::size_t p = 0; p < points_; p += tile) {
      NativeLanes here{};
      for (std::size_t m = 0; m < moments_; ++m) here += polynomial[m] * load<NativeLanes>(row(m) + p);
      store(&out[p], here);
    }
    return out;
  }

  /// Whether minus this polynomial, of these values at points, plus what makes it positive there, shows that there are
  /// no such weights.
  bool is_impossible(std::vector<Real> const& polynomial, std::vector<Real> const& values) const {
    Real const size = std::sqrt(dot(polynomial.data(), polynomial.data(), rows_));
    if (size == 0) return false;
    Real const lift = largest_or_zero(values.data(), points_);
    Real const least_sum = sum(points_, [&](std::size_t p) {
      return least_weight * load<NativeLanes>(&volume_[p]) * (lift - load<NativeLanes>(&values[p]));
    });
    return lift - polynomial[0] - least_sum < -1e-10 * size;
  }

  /// F at the present λ plus a step, without what does not change.
  Real objective(std::vector<Real> const& change, Real step, Real along_b) const {
    return sum(points_,
               [&](std::size_t p) {
                 auto const t = 1 + load<NativeLanes>(&slope_[p]) + step * load<NativeLanes>(&change[p]);
                 auto const psi = t > least_weight ? t * t / 2 : least_weight * t - least_weight * least_weight / 2;
                 return load<NativeLanes>(&volume_[p]) * psi;
               }) -
           step * along_b;
  }

  void go(Real step, std::vector<Real> const& direction, std::vector<Real> const& change) {
    for (std::size_t p = 0; p < points_; ++p) slope_[p] += step * change[p];
    for (std::size_t m = 0; m < moments_; ++m) lambda_[m] += step * direction[m];
    set_weights();
  }

  /// λ goes along a direction, a `change` at points, as far as F falls as it should. Whether it could.
  bool advance(std::vector<Real> const& direction, std::vector<Real> const& change, std::vector<Real> const& residual) {
    Real const falls = dot(direction.data(), residual.data(), rows_);
    Real const before = objective(change, 0, direction[0]);
    for (Real step = 1; step > 1e-10; step /= 2) {
      if (objective(change, step, direction[0]) > before - 1e-4 * step * falls + 1e-15 * std::abs(before)) continue;
      go(step, direction, change);
      return true;
    }
    return false;
  }

  std::size_t points_;
  std::vector<Real> const& volume_;  ///< in parts of the element's
  std::size_t moments_, rows_;
  Array a_, h_, of_root_;                      ///< each moment's polynomial at points; second derivatives of F
  std::vector<Real> above_;                    ///< those are of the volumes of points above their least weights
  std::optional<Cholesky> root_;               ///< of h_
  std::vector<Real> slope_, lambda_, weight_;  ///< A'λ at points
};

/// The weights of one element, in parts of its volume, and to which degree they are exact.
int fit(Real const* reference, std::vector<Real> const& volume, std::size_t count, int highest,
        std::vector<Real>& weight) {
  auto const found = [&](int degree, bool doubtful = false) {
    return Fit(reference, volume, count, degree).find(weight, doubtful);
  };
  int reached = (highest + 1) / 2;  // of elements of this degree: most reach it, and few go far beyond
  if (!found(reached)) {
    while (--reached >= 0 && !found(reached)) continue;
    if (reached < 0) weight = volume;
    return reached;
  }
  while (reached < highest && found(reached + 1, true)) ++reached;
  return reached;
}

}  // namespace

FittedWeights fit_moments(std::vector<std::int64_t> const& first, Real const* reference, Real const* volume,
                          bool const* full, Real element_volume, int highest) {
  FittedWeights out{{volume, volume + first.back()}, {}};
  std::vector<Real> parts, before, weight;
  Real const* place_before = nullptr;
  int degree = not_fitted;
  for (std::size_t e = 0; e + 1 < first.size(); ++e) {
    out.degree.push_back(not_fitted);
    if (!full[e]) continue;
    std::size_t const count = std::size_t(first[e + 1] - first[e]);
    Real const* const place = reference + 3 * first[e];
    parts.clear();
    Real const sum = std::accumulate(volume + first[e], volume + first[e + 1], Real(0));
    for (std::int64_t p = first[e]; p < first[e + 1]; ++p) parts.push_back(volume[p] / sum);
    parts.resize(padded(count), 0);
    bool const same = place_before && parts == before && std::equal(place, place + 3 * count, place_before);
    if (!same) degree = fit(place, parts, count, highest, weight);
    out.degree.back() = degree;
    before = parts, place_before = place;
    for (std::size_t p = 0; p < count; ++p) out.weight[std::size_t(first[e]) + p] = weight[p] * element_volume;
  }
  return out;
}

}  // namespace amrpic::fem
