#pragma once

#include <cstddef>
#include <vector>

#include "base/large_array.hpp"

namespace amrpic::matrixfree {

/// Memory on whole cache lines, so that a row of cells starts where a vector register's load does not straddle two.
template <class T>
struct CacheLines {
  using value_type = T;
  CacheLines() = default;
  template <class U>
  CacheLines(CacheLines<U> const&) {}
  T* allocate(std::size_t n) { return static_cast<T*>(allocate_lines(n * sizeof(T))); }
  void deallocate(T* block, std::size_t n) { deallocate_lines(block, n * sizeof(T)); }
  template <class U>
  bool operator==(CacheLines<U> const&) const {
    return true;
  }
  template <class U>
  bool operator!=(CacheLines<U> const&) const {
    return false;
  }
};

/// Values of a level's blocks in single precision; see Layout.
using Vector = std::vector<float, CacheLines<float>>;

}  // namespace amrpic::matrixfree
