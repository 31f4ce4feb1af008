#pragma once

#include <cstdint>

namespace amrpic {

/// Elements [first, last) of a list.
struct Range {
  std::int32_t first = 0, last = 0;
  bool empty() const { return first == last; }
};

}  // namespace amrpic
