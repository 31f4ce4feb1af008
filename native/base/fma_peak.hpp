#pragma once

#include "base/types.hpp"

namespace amrpic {

/// Most floating-point operations per second of this rank's core: products and sums of vectors that stay in registers,
/// two operations each. The best of hundreds of runs of a tenth of a millisecond, as on a shared machine others take
/// the core in longer ones.
Real measure_fma_peak();

}  // namespace amrpic
