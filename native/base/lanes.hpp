// The vectors of all kernels. In single precision as many numbers as the processor takes; in double precision eight at
// a time, in one vector, or with AVX2 in two halves: the same operations in the same order give the same bits in both.
//
// Compilers split longer vectors than the processor has by themselves, but take comparisons, choices and permutations
// of such vectors apart number by number.
#pragma once

#include "base/float_lanes.hpp"
#include "base/lane_types.hpp"
#if defined(__AVX2__) && !defined(AMRPIC_AVX512) && !defined(__CUDACC__)  // whose front end takes no halves
#include "base/lanes_avx2.hpp"
#else
#include "base/lanes_in_one.hpp"
#endif

namespace amrpic {

/// Write the first three of each four numbers, and a zero as the fourth one.
inline void interleave(Lanes const& x, Lanes const& y, Lanes const& z, Real* out) {
  auto const parts = interleaved(x, y, z);
  for (int n = 0; n < 4; ++n) store(out + lane_count * n, parts[std::size_t(n)]);
}

}  // namespace amrpic
