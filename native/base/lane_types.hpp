// What is common to both kinds of `Lanes`; included by base/lanes.hpp.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <type_traits>
#include <utility>

#include "base/intrinsics.hpp"
#include "base/kokkos.hpp"
#include "base/types.hpp"

namespace amrpic {

constexpr int lane_count = 8;
constexpr unsigned all_lanes = (1u << lane_count) - 1;  ///< a bit for each

typedef Real HalfLanes __attribute__((vector_size(8 * lane_count / 2)));
typedef std::int32_t IndexLanes __attribute__((vector_size(4 * lane_count)));

/// The vector at an address.
template <class Vector>
inline Vector load(void const* from) {
  if constexpr (std::is_class_v<Vector>) {
    return Vector::at(from);
  } else {
    Vector out;
    std::memcpy(&out, from, sizeof out);
    return out;
  }
}

template <class Vector>
inline void store(void* to, Vector const& values) {
  if constexpr (std::is_class_v<Vector>)
    values.write(to);
  else
    std::memcpy(to, &values, sizeof values);
}

/// What a vector holds.
template <class Vector>
using NumberOf = std::decay_t<decltype(std::declval<Vector>()[0])>;

/// Call f(n) for each bit that is set.
template <class Bits, class F>
void for_each_bit(Bits bits, F&& f) {
  for (; bits != 0; bits &= bits - 1) f(__builtin_ctzll(bits));
}

// Of one number, as of each of `Lanes`.
KOKKOS_INLINE_FUNCTION Real select(bool which, Real yes, Real no) { return which ? yes : no; }
KOKKOS_INLINE_FUNCTION Real square_root(Real x) { return std::sqrt(x); }
KOKKOS_INLINE_FUNCTION Real round_down(Real x) { return std::floor(x); }

}  // namespace amrpic
