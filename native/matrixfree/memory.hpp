#pragma once

#include <cstddef>
#include <new>
#include <vector>

namespace amrpic::matrixfree {

/// Memory on whole cache lines, so that a row of cells starts where a vector register's load does not straddle two.
template <class T>
struct CacheLines {
  using value_type = T;
  static constexpr std::align_val_t line{64};
  CacheLines() = default;
  template <class U>
  CacheLines(CacheLines<U> const&) {}
  T* allocate(std::size_t n) { return static_cast<T*>(::operator new(n * sizeof(T), line)); }
  void deallocate(T* p, std::size_t) { ::operator delete(p, line); }
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
