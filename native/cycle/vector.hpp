#pragma once

#include <vector>

#include "base/large_array.hpp"

namespace amrpic::cycle {

/// Values of a level's blocks in single precision; see Layout. They start on a cache line, so that a vector register's
/// load of a row does not straddle two.
using Vector = std::vector<float, CacheLines<float>>;

}  // namespace amrpic::cycle
