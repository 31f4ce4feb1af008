#include "base/fma_peak.hpp"

#include <algorithm>
#include <chrono>

#include "base/native_lanes.hpp"

namespace amrpic {

Real measure_fma_peak() {
  constexpr int chains = 10, steps = 8000, runs = 500;  // chains of sums: more than latency takes, fewer than registers
  using Clock = std::chrono::steady_clock;
  NativeLanes sums[chains] = {}, factor = NativeLanes{} + Real(0.999), term = NativeLanes{} + Real(1e-3);
  Real best = 0;
  for (int run = 0; run < runs; ++run) {
    auto const start = Clock::now();
    for (int step = 0; step < steps; ++step)
#pragma GCC unroll 10
      for (NativeLanes& sum : sums) sum = sum * factor + term;
    Real const seconds = std::chrono::duration<Real>(Clock::now() - start).count();
    best = std::max(best, Real(2) * native_lane_count * chains * steps / seconds);
  }
  Real kept = 0;
  for (NativeLanes const& sum : sums) kept += sum[0];
  return kept < 0 ? 0 : best;  // never the former: what is computed is used
}

}  // namespace amrpic
