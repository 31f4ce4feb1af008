// Small dense systems, solved with vectors of the processor. Rows and vectors fill whole ones, up with zeros.
#pragma once

#include <algorithm>
#include <vector>

#include "base/large_array.hpp"
#include "base/native_lanes.hpp"

namespace amrpic::fem {

using Array = LargeArray<Real>;

constexpr std::size_t tile = native_lane_count;

/// The least whole vectors that hold so many numbers.
inline std::size_t padded(std::size_t count) { return (count + tile - 1) / tile * tile; }

inline Real sum_of_lanes(NativeLanes v) {
  for (int half = native_lane_count / 2; half > 0; half /= 2)
    for (int l = 0; l < half; ++l) v[l] += v[l + half];
  return v[0];
}

/// The sum of f(n), vectors of what numbers from n on give, over numbers that fill whole vectors.
template <class F>
Real sum(std::size_t count, F&& f) {
  NativeLanes sums{};
  for (std::size_t n = 0; n < count; n += native_lane_count) sums += f(n);
  return sum_of_lanes(sums);
}

inline Real dot(Real const* a, Real const* b, std::size_t count) {
  return sum(count, [&](std::size_t n) { return load<NativeLanes>(a + n) * load<NativeLanes>(b + n); });
}

/// Products of so many rows with another one, which is read once for all.
inline NativeLanes dots(Real const* rows, Real const* b, std::size_t count) {
  NativeLanes sums[tile] = {};
  for (std::size_t n = 0; n < count; n += native_lane_count) {
    auto const other = load<NativeLanes>(b + n);
    for (std::size_t r = 0; r < tile; ++r) sums[r] += load<NativeLanes>(rows + r * count + n) * other;
  }
  return sums_of_lanes(sums);
}

/// The square root of a positive definite matrix U'U. Rows are as many as a multiple of a tile.
class Cholesky {
 public:
  /// Of the upper triangle of `matrix`, which it overwrites; `shift` is added to its diagonal.
  Cholesky(Array& matrix, std::size_t size, Real shift);

  /// The solution, in place of the right-hand side.
  void solve(std::vector<Real>& b) const;

 private:
  void subtract(Real* a, Real by, Real const* b, std::size_t first) const;
  void subtract_rows_before(std::size_t first, std::size_t column) const;
  Real* row(std::size_t i) const { return u_ + i * stride_; }

  Real* u_;
  std::size_t size_, stride_;
  std::vector<Real> reciprocal_;  ///< of the diagonal
};

}  // namespace amrpic::fem
