// Arrays of megabytes.
#pragma once

#include <cstddef>
#include <new>
#include <utility>
#include <vector>

#include "base/pool.hpp"

namespace amrpic {

constexpr std::size_t cache_line = 64;

/// From this size on blocks come from a pool, and lie in huge pages where the system has them. A pass over arrays that
/// no cache holds takes a fifth less then, and the faults of fresh 4 KiB pages as long as all else in the assembly of
/// operators.
constexpr std::size_t large_block = std::size_t(1) << 22;

/// Memory from a cache line on.
inline void* allocate_lines(std::size_t bytes) {
  return bytes < large_block ? ::operator new(bytes, std::align_val_t(cache_line)) : pool_of_large_arrays().take(bytes);
}
inline void deallocate_lines(void* block, std::size_t bytes) {
  bytes < large_block ? ::operator delete(block, std::align_val_t(cache_line)) : pool_of_large_arrays().give(block);
}

/// Allocates such memory, and leaves new elements unset unless they are given a value.
template <class T>
struct LargeAllocator {
  using value_type = T;
  LargeAllocator() = default;
  template <class U>
  LargeAllocator(LargeAllocator<U> const&) {}

  T* allocate(std::size_t n) { return static_cast<T*>(allocate_lines(n * sizeof(T))); }
  void deallocate(T* block, std::size_t n) { deallocate_lines(block, n * sizeof(T)); }
  template <class U, class... Args>
  void construct(U* at, Args&&... args) {
    if constexpr (sizeof...(Args) == 0)
      ::new (static_cast<void*>(at)) U;  // left as it is
    else
      ::new (static_cast<void*>(at)) U(std::forward<Args>(args)...);
  }
  template <class U>
  bool operator==(LargeAllocator<U> const&) const {
    return true;
  }
  template <class U>
  bool operator!=(LargeAllocator<U> const&) const {
    return false;
  }
};

/// A vector whose `resize` leaves new elements unset.
template <class T>
using LargeArray = std::vector<T, LargeAllocator<T>>;

}  // namespace amrpic
