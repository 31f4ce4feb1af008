// Means of eight children: what a covered cell holds.
#pragma once

#include <cstddef>
#include <cstring>

#include "base/types.hpp"

// How vectors are passed matters between object files built for different processors; here all is inlined.
#pragma GCC diagnostic ignored "-Wpsabi"

namespace amrpic {

namespace detail {

/// Sums of the `width` pairs that a row of numbers is made of.
template <int width>
struct Pairs;

template <>
struct Pairs<8> {
  typedef Real Sums __attribute__((vector_size(64)));
  static Sums of(Real const* row) {
    Sums low, high;
    std::memcpy(&low, row, sizeof low);
    std::memcpy(&high, row + 8, sizeof high);
    return __builtin_shufflevector(low, high, 0, 2, 4, 6, 8, 10, 12, 14) +
           __builtin_shufflevector(low, high, 1, 3, 5, 7, 9, 11, 13, 15);
  }
};
template <>
struct Pairs<4> {
  typedef Real Sums __attribute__((vector_size(32)));
  static Sums of(Real const* row) {
    Sums low, high;
    std::memcpy(&low, row, sizeof low);
    std::memcpy(&high, row + 4, sizeof high);
    return __builtin_shufflevector(low, high, 0, 2, 4, 6) + __builtin_shufflevector(low, high, 1, 3, 5, 7);
  }
};
template <>
struct Pairs<1> {
  typedef Real Sums;
  static Sums of(Real const* row) { return row[0] + row[1]; }
};

/// The next `width` parents as long as there are so many.
template <int width>
int average(int done, int count, Real const* child, std::ptrdiff_t y, std::ptrdiff_t z, Real* parent) {
  for (; done + width <= count; done += width) {
    Real const* const first = child + 2 * std::ptrdiff_t(done);
    auto const of = [&](std::ptrdiff_t row) { return Pairs<width>::of(first + row); };
    typename Pairs<width>::Sums const mean = (((of(0) + of(y)) + of(z)) + of(y + z)) * 0.125;
    std::memcpy(parent + done, &mean, sizeof mean);
  }
  return done;
}

}  // namespace detail

/// Set a row of parents to the means of their children, whose first one is `child`, with so much between rows and
/// planes. Each mean rounds alike wherever it stands in a row.
inline void average_children(int count, Real const* child, std::ptrdiff_t y, std::ptrdiff_t z, Real* parent) {
  int done = detail::average<8>(0, count, child, y, z, parent);
  done = detail::average<4>(done, count, child, y, z, parent);
  detail::average<1>(done, count, child, y, z, parent);
}

}  // namespace amrpic
