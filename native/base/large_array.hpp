// Arrays of megabytes.
#pragma once

#include <sys/mman.h>

#include <cstddef>
#include <new>
#include <utility>
#include <vector>

namespace amrpic {

constexpr std::size_t cache_line = 64, huge_page = std::size_t(1) << 21;

/// Memory from a cache line on; large blocks in huge pages where the system has them. A pass over arrays that no cache
/// holds takes a fifth less then, and the faults of 4 KiB pages as long as all else in the assembly of operators.
inline void* allocate_lines(std::size_t bytes) {
  if (bytes < 2 * huge_page) return ::operator new(bytes, std::align_val_t(cache_line));
  void* const block = ::operator new(bytes, std::align_val_t(huge_page));
#ifdef MADV_HUGEPAGE
  madvise(block, bytes / huge_page * huge_page, MADV_HUGEPAGE);  // whole pages alone; a refusal does no harm
#endif
  return block;
}
inline void deallocate_lines(void* block, std::size_t bytes) {
  ::operator delete(block, std::align_val_t(bytes < 2 * huge_page ? cache_line : huge_page));
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
