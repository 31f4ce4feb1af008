#pragma once

#include <array>
#include <cstdint>

#include "base/kokkos.hpp"

namespace amrpic {

using Real = double;
using LocalIndex = std::int32_t;   ///< a cell or particle on this rank
using GlobalIndex = std::int64_t;  ///< a cell of a level, over all ranks

using Index3 = std::array<int, 3>;
using Real3 = std::array<Real, 3>;
template <class V>
using Vector3 = std::array<V, 3>;  ///< of one place or of several

/// The two axes of a plane normal to `axis`, in ascending order.
constexpr std::array<int, 2> tangential_axes(int axis) {
  if (axis == 0) return {1, 2};
  if (axis == 1) return {0, 2};
  return {0, 1};
}

/// Quotient rounded towards minus infinity; `b` > 0.
KOKKOS_INLINE_FUNCTION constexpr int floor_divide(int a, int b) { return a >= 0 ? a / b : -((-a + b - 1) / b); }

}  // namespace amrpic
