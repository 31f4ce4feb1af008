#pragma once

#include "base/kokkos.hpp"

namespace amrpic {

// A relaxation step of h² L e = r, L e being `sum`, over the neighbours, less `diagonal` times e.

/// The value after a step: `keep` is one less the relaxation factor, `step` the factor over the diagonal.
template <class Factor, class Step, class Value>
KOKKOS_INLINE_FUNCTION Value relaxed(Factor const& keep, Value const& e, Step const& step, Value const& sum,
                                     Value const& r) {
  return keep * e + step * (sum - r);
}
/// The same where all values are zero.
template <class Value>
KOKKOS_INLINE_FUNCTION Value relaxed_from_zero(Value const& step, Value const& r) {
  return -step * r;
}
/// What of r is left.
template <class Value>
KOKKOS_INLINE_FUNCTION Value remaining(Value const& r, Value const& sum, Value const& diagonal, Value const& e) {
  return r - (sum - diagonal * e);
}

}  // namespace amrpic
