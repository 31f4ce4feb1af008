// Arrays of megabytes that are written right after they are made.
#pragma once

#include <sys/mman.h>

#include <cstddef>
#include <new>
#include <utility>
#include <vector>

namespace amrpic {

/// Allocates without setting to zero, and large blocks in huge pages where the system has them: the faults of 4 KiB
/// pages took as long as all else in the assembly of operators.
template <class T>
struct LargeAllocator {
  using value_type = T;
  LargeAllocator() = default;
  template <class U>
  LargeAllocator(LargeAllocator<U> const&) {}

  T* allocate(std::size_t n) {
    std::size_t const bytes = n * sizeof(T);
    if (bytes < 2 * huge_page) return static_cast<T*>(::operator new(bytes));
    void* const block = ::operator new(bytes, std::align_val_t(huge_page));
#ifdef MADV_HUGEPAGE
    madvise(block, bytes / huge_page * huge_page, MADV_HUGEPAGE);  // whole pages alone; a refusal does no harm
#endif
    return static_cast<T*>(block);
  }
  void deallocate(T* block, std::size_t n) {
    if (n * sizeof(T) < 2 * huge_page)
      ::operator delete(block);
    else
      ::operator delete(block, std::align_val_t(huge_page));
  }
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

 private:
  static constexpr std::size_t huge_page = std::size_t(1) << 21;
};

/// A vector whose `resize` leaves new elements unset.
template <class T>
using LargeArray = std::vector<T, LargeAllocator<T>>;

}  // namespace amrpic
