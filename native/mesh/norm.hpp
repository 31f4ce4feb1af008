#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <type_traits>

#include "base/communicator.hpp"
#include "base/types.hpp"

namespace amrpic {

/// Norms over cells; l1 and l2 are weighted by volume.
enum class Norm { l1, l2, max };

/// A running maximum of magnitudes. The bits of magnitudes order as whole numbers, infinity and nan above all others.
template <class T>
class Largest {
 public:
  static constexpr int lanes = 16;  // side by side, so that none waits for another

  void add(T const* values, std::ptrdiff_t n) {
    std::ptrdiff_t i = 0;
    if (n >= lanes) {
      Bits largest[lanes] = {};
      for (; i + lanes <= n; i += lanes)
        for (int q = 0; q < lanes; ++q) largest[q] = std::max(largest[q], bits(values[i + q]));
      for (Bits part : largest) largest_ = std::max(largest_, part);
    }
    for (; i < n; ++i) largest_ = std::max(largest_, bits(values[i]));
  }
  T value() const {
    T out;
    std::memcpy(&out, &largest_, sizeof out);
    return out;
  }

 private:
  using Bits = std::conditional_t<sizeof(T) == 4, std::int32_t, std::int64_t>;
  static Bits bits(T value) {
    Bits out;
    std::memcpy(&out, &value, sizeof out);
    return out & std::numeric_limits<Bits>::max();
  }

  Bits largest_ = 0;
};

/// One rank's part of a norm over cells, for numbers of any size.
///
/// Squares of numbers below 1e-154 or above 1e154 are no doubles. So sums are kept in three ranges: of numbers as they
/// are, and of small and large ones times 2^600 or 2^-600 (J. L. Blue, ACM Trans. Math. Softw. 4, 1978). Numbers of
/// ordinary size are summed as if the other two were not there.
class Magnitude {
 public:
  explicit Magnitude(Norm norm) : norm_(norm) {}

  /// Take in values of cells of equal volume.
  void add(Real const* values, std::ptrdiff_t n, Real volume) {
    auto const largest = [&] {
      Largest<Real> of_all;
      of_all.add(values, n);
      return of_all.value();
    };
    add_by(
        largest, [&](Real factor) { return sum_of(norm_, values, n, factor); }, volume);
  }

  /// The same for values that lie elsewhere: `largest()` is their largest magnitude, as `Largest` has it, and
  /// `sum(factor)` the sum of the magnitudes of factor times each, or of their squares for l2.
  template <class LargestOf, class SumOf>
  void add_by(LargestOf&& largest_of, SumOf&& sum_of_scaled, Real volume) {
    if (norm_ == Norm::max) {
      Real const value = largest_of();
      return largest_.add(&value, 1);
    }
    Real const sum = sum_of_scaled(Real(1));
    if (sum > least_sum && sum < greatest_sum) {
      sums_[ordinary] += volume * sum;
      return;
    }
    Real const largest = largest_of();
    int const range = largest < least ? small : largest > greatest ? large : ordinary;
    sums_[range] += volume * sum_of_scaled(scale[range]);
  }

  /// Such a sum, of values side by side.
  static Real sum_of(Norm norm, Real const* values, std::ptrdiff_t n, Real factor) {
    Real lane[8] = {};
    std::ptrdiff_t i = 0;
    auto const size = [=](Real v) { return norm == Norm::l1 ? std::abs(factor * v) : (factor * v) * (factor * v); };
    for (; i + 8 <= n; i += 8)
      for (int q = 0; q < 8; ++q) lane[q] += size(values[i + q]);
    for (; i < n; ++i) lane[0] += size(values[i]);
    Real out = 0;
    for (Real part : lane) out += part;
    return out;
  }

  /// The norm over all ranks; nan if a value is not finite. Collective.
  Real over(Communicator const& comm) const {
    constexpr Real nan = std::numeric_limits<Real>::quiet_NaN(), infinity = std::numeric_limits<Real>::infinity();
    if (norm_ == Norm::max) {
      Real const own = largest_.value();
      Real const largest = comm.largest(std::isfinite(own) ? own : infinity);  // the largest of all may drop a nan
      return std::isfinite(largest) ? largest : nan;
    }
    std::array<Real, 3> sums = sums_;
    comm.sum_each(sums);
    for (Real sum : sums)
      if (!std::isfinite(sum)) return nan;
    // what a range adds to the next larger one
    Real const step = norm_ == Norm::l1 ? down : down * down;
    if (sums[large] > 0) return root(sums[large] + step * sums[ordinary]) * up;
    if (sums[ordinary] > 0) return root(sums[ordinary] + step * sums[small]);
    return root(sums[small]) * down;
  }

 private:
  enum Range { small, ordinary, large };
  static constexpr Real up = 0x1p600, down = 0x1p-600;
  static constexpr std::array<Real, 3> scale{up, 1, down};
  static constexpr Real least = 0x1p-400, greatest = 0x1p400;          ///< largest numbers of the ordinary range
  static constexpr Real least_sum = 0x1p-800, greatest_sum = 0x1p800;  ///< what squares of those add up to

  Real root(Real sum) const { return norm_ == Norm::l2 ? std::sqrt(sum) : sum; }

  Norm norm_;
  Largest<Real> largest_;
  std::array<Real, 3> sums_{};
};

}  // namespace amrpic
