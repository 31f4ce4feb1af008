// Arrays over the cells of a mesh.
#pragma once

#include <cstddef>
#include <new>
#include <utility>
#include <vector>

#include "base/pool.hpp"

namespace amrpic {

constexpr std::size_t cache_line = 64;

/// From this size on blocks come from a pool: the faults of fresh pages took as long as all else in the assembly of
/// operators, and a fifth of the time of E on small meshes, where the system takes back what a step frees.
constexpr std::size_t large_block = std::size_t(1) << 18;

/// Allocates from a cache line on.
template <class T>
struct CacheLines {
  using value_type = T;
  CacheLines() = default;
  template <class U>
  CacheLines(CacheLines<U> const&) {}

  T* allocate(std::size_t n) {
    std::size_t const bytes = n * sizeof(T);
    return static_cast<T*>(bytes < large_block ? ::operator new(bytes, std::align_val_t(cache_line))
                                               : pool_of_large_arrays().take(bytes));
  }
  void deallocate(T* block, std::size_t n) {
    if (n * sizeof(T) < large_block)
      ::operator delete(block, std::align_val_t(cache_line));
    else
      pool_of_large_arrays().give(block);
  }
  template <class U>
  bool operator==(CacheLines<U> const&) const {
    return true;
  }
  template <class U>
  bool operator!=(CacheLines<U> const&) const {
    return false;
  }
};

/// The same, and leaves new elements unset unless they are given a value.
template <class T>
struct LargeAllocator : CacheLines<T> {
  LargeAllocator() = default;
  template <class U>
  LargeAllocator(LargeAllocator<U> const&) {}

  template <class U, class... Args>
  void construct(U* at, Args&&... args) {
    if constexpr (sizeof...(Args) == 0)
      ::new (static_cast<void*>(at)) U;  // left as it is
    else
      ::new (static_cast<void*>(at)) U(std::forward<Args>(args)...);
  }
};

/// A vector whose `resize` leaves new elements unset.
template <class T>
using LargeArray = std::vector<T, LargeAllocator<T>>;

}  // namespace amrpic
