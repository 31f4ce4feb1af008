#pragma once

#include "base/types.hpp"

namespace amrpic {

/// a b + c, rounded once where the processor can: in the vector body and the rest of a loop alike.
inline Real fused(Real a, Real b, Real c) {
#ifdef __FMA__
  return __builtin_fma(a, b, c);
#else
  return a * b + c;
#endif
}

}  // namespace amrpic
