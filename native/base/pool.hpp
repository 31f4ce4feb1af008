// Large blocks of memory, used again. Each step makes and drops arrays of about the same size, and the system takes as
// long to hand out a fresh page as a kernel takes to fill it several times.
#pragma once

#include <cstddef>
#include <mutex>
#include <unordered_map>
#include <vector>

namespace amrpic {

/// How a device is told of memory that it is to copy from and to without a detour, and that it is to forget it. What it
/// cannot take it copies as before.
struct PageLock {
  void (*lock)(void* memory, std::size_t bytes) = nullptr;
  void (*unlock)(void* memory) = nullptr;
};

class Pool {
 public:
  /// At most `most_idle` times the memory in use lies idle, beside what is reserved, and never so much that with what
  /// is in use it would be an eighth more than was once in use at a time. Without that eighth, steps that take blocks
  /// of many sizes in turn free what they take next, and find new pages each time.
  explicit Pool(double most_idle);

  /// From now on let a device know the blocks of all pools.
  static void lock_pages(PageLock const& by);

  /// A block of at least so many bytes, starting on a page, with whatever it holds. Throws std::bad_alloc.
  void* take(std::size_t bytes);

  /// Give back what `take` gave: kept to be taken again, unless too much lies idle.
  void give(void* memory) noexcept;

  std::size_t idle();  ///< bytes that are kept to be taken again

  void reserve(std::size_t bytes);  ///< let so many more lie idle
  void end_reserve(std::size_t bytes) noexcept;

 private:
  struct IdleMemory {
    std::size_t bytes;
    void* memory;
  };
  void lock_all();
  void free_oldest();
  void free_what_is_too_much() noexcept;

  double most_idle_;
  std::mutex mutex_;
  std::vector<IdleMemory> idle_;                  ///< in the order they were given back
  std::unordered_map<void*, std::size_t> sizes_;  ///< of those in use
  std::size_t idle_total_ = 0, used_total_ = 0, most_used_ = 0, reserved_ = 0;
};

/// That of arrays over the cells of a mesh.
Pool& pool_of_large_arrays();

}  // namespace amrpic
