#pragma once

#ifdef __SSE2__
#include <xmmintrin.h>
#endif

namespace amrpic {

/// Numbers too small for full precision count as zero while this lives: far from all charge corrections fade to
/// nothing, and the processor would take a hundred times as long with them.
class NoDenormals {
 public:
#ifdef __SSE2__
  NoDenormals() : before_(_mm_getcsr()) { _mm_setcsr(before_ | 0x8040); }
  ~NoDenormals() { _mm_setcsr(before_); }

 private:
  unsigned before_;
#endif
};

}  // namespace amrpic
