// Columns of a caller's particles, in the caller's order and of any stride, on their way to kernels and back.
#pragma once

#include <array>
#include <cstdint>

#include "base/types.hpp"

namespace amrpic {

/// Values at equal distances in memory.
struct StridedColumn {
  Real const* first;
  std::int64_t stride;

  Real operator[](std::int64_t n) const { return first[n * stride]; }
};

/// What a caller's values add up to, and between which they lie. Both sums are not finite if a value is not.
struct ColumnSums {
  Real sum, magnitude;  ///< Σ v, Σ |v|
  Real least, greatest;
};

/// Write (v - shift) · scale of the values v at so many places, or of the first ones if there are no places, into
/// `out`, unless that is null. Returned are sums and bounds of v.
ColumnSums take_column(StridedColumn const& from, std::int64_t const* places, std::int64_t count, Real shift,
                       Real scale, Real* out);

/// Where a caller has values: of the n-th particle at places[n], and there times a factor for each component.
struct CallersPlaces {
  std::int64_t const* places;
  std::int64_t count;
  Real3 factors;
};

/// Write components of values to a caller's places.
void put_into_places(std::array<Real*, 3> const& values, CallersPlaces const& to, std::array<Real*, 3> const& out);

}  // namespace amrpic
