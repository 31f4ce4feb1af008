#pragma once

#include "base/kokkos.hpp"
#include "base/types.hpp"

namespace amrpic {

/// a b + c, rounded once where the processor can: both in the vector body and in the rest of a loop.
KOKKOS_INLINE_FUNCTION Real fused(Real a, Real b, Real c) {
#ifdef __FMA__
  return __builtin_fma(a, b, c);
#else
  return a * b + c;
#endif
}

}  // namespace amrpic
