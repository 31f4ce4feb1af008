// Products of vectors, of numbers or of eight at a time; the first may be of plain numbers.
#pragma once

#include "base/kokkos.hpp"
#include "base/types.hpp"

namespace amrpic {

template <class A, class V>
KOKKOS_INLINE_FUNCTION V dot(Vector3<A> const& a, Vector3<V> const& b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}
template <class A, class V>
KOKKOS_INLINE_FUNCTION Vector3<V> cross(Vector3<A> const& a, Vector3<V> const& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
template <class V>
KOKKOS_INLINE_FUNCTION Vector3<V> scaled(V const& by, Vector3<V> const& a) {
  return {by * a[0], by * a[1], by * a[2]};
}

}  // namespace amrpic
