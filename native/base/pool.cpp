#include "base/pool.hpp"

#include <algorithm>
#include <cstdlib>
#include <iterator>
#include <new>

#include "base/huge_pages.hpp"

namespace amrpic {

namespace {

constexpr std::size_t small_page = 4096, large_page = std::size_t(1) << 21;

/// Sizes in steps of a sixteenth, so that arrays that grow or shrink a little find their old place. Pages that are
/// never touched cost nothing, and the last large one less than there is to it.
[[maybe_unused]] std::size_t rounded(std::size_t bytes) {
  std::size_t step = small_page;
  while (step * 32 <= bytes) step *= 2;
  return std::max(step, (bytes + step - 1) / step * step);
}

[[maybe_unused]] void* new_block(std::size_t bytes) {
  bool const large = bytes >= 2 * large_page;
  std::size_t const page = large ? large_page : small_page;
  void* block = std::aligned_alloc(page, (bytes + page - 1) / page * page);
  if (!block) throw std::bad_alloc();
  advise_huge_pages(block, bytes);
  return block;
}

PageLock page_lock;

/// Never destroyed, as the pools themselves.
std::vector<Pool*>& pools() {
  static auto* const all = new std::vector<Pool*>;
  return *all;
}

}  // namespace

Pool::Pool(double most_idle) : most_idle_(most_idle) { pools().push_back(this); }

void Pool::lock_pages(PageLock const& by) {
  page_lock = by;
  for (Pool* pool : pools()) pool->lock_all();
}

void Pool::lock_all() {
  std::lock_guard const lock(mutex_);
  for (IdleMemory const& block : idle_) page_lock.lock(block.memory, block.bytes);
  for (auto const& [memory, bytes] : sizes_) page_lock.lock(memory, bytes);
}

#ifdef AMRPIC_NO_POOL
// For sanitizers (`make sanitize`): each block by itself, its last byte the last that may be read.
void* Pool::take(std::size_t bytes) {
  void* memory = nullptr;
  if (posix_memalign(&memory, small_page, bytes) != 0) throw std::bad_alloc();
  return memory;
}

void Pool::give(void* memory) noexcept { std::free(memory); }
#else
void* Pool::take(std::size_t bytes) {
  std::lock_guard const lock(mutex_);
  bytes = rounded(bytes);
  // The latest one is the likeliest to be in the cache.
  auto const found = std::find_if(idle_.rbegin(), idle_.rend(), [&](IdleMemory const& b) { return b.bytes == bytes; });
  void* memory = nullptr;
  if (found != idle_.rend()) {
    memory = found->memory;
    idle_.erase(std::prev(found.base()));
    idle_total_ -= bytes;
  } else {
    while (!idle_.empty() && used_total_ + idle_total_ + bytes > most_used_ + most_used_ / 8) free_oldest();
    memory = new_block(bytes);
    if (page_lock.lock) page_lock.lock(memory, bytes);
  }
  sizes_[memory] = bytes;
  used_total_ += bytes;
  most_used_ = std::max(most_used_, used_total_);
  return memory;
}

void Pool::give(void* memory) noexcept {
  std::lock_guard const lock(mutex_);
  auto const known = sizes_.find(memory);
  idle_.push_back({known->second, memory});
  idle_total_ += known->second;
  used_total_ -= known->second;
  sizes_.erase(known);
  free_what_is_too_much();
}
#endif

void Pool::reserve(std::size_t bytes) {
  std::lock_guard const lock(mutex_);
  reserved_ += bytes;
}

void Pool::end_reserve(std::size_t bytes) noexcept {
  std::lock_guard const lock(mutex_);
  reserved_ -= bytes;
  free_what_is_too_much();
}

void Pool::free_what_is_too_much() noexcept {
  while (!idle_.empty() && double(idle_total_) > most_idle_ * double(used_total_) + double(reserved_)) free_oldest();
}

void Pool::free_oldest() {
  if (page_lock.unlock) page_lock.unlock(idle_.front().memory);
  std::free(idle_.front().memory);
  idle_total_ -= idle_.front().bytes;
  idle_.erase(idle_.begin());
}

std::size_t Pool::idle() {
  std::lock_guard const lock(mutex_);
  return idle_total_;
}

/// As much may lie idle as is in use: while a step makes its fields those of the step before live, and between steps
/// they do not. Never destroyed: Python may drop its last array after the program's static objects are gone.
Pool& pool_of_large_arrays() {
  static Pool* const the_one = new Pool(1);
  return *the_one;
}

}  // namespace amrpic
