// Memory of particle arrays, used again. Each step makes and drops arrays of about the same size, and the system takes
// as long to hand out a fresh page as a kernel takes to fill it several times.
#pragma once

#include <cstddef>
#include <memory>
#include <type_traits>

namespace amrpic {

/// A block of at least so many bytes, starting on a cache line, with whatever it holds. Throws std::bad_alloc.
void* take_block(std::size_t bytes);

/// Give back what `take_block` gave: kept to be taken again, unless more lies idle than the run can use.
void give_block(void* block) noexcept;

/// Bytes that are kept to be taken again.
std::size_t idle_bytes();

/// As long as this lives, so many more bytes are kept to be taken again: for what is done now and then.
class ReservedMemory {
 public:
  explicit ReservedMemory(std::size_t bytes);
  ~ReservedMemory();
  ReservedMemory(ReservedMemory const&) = delete;

 private:
  std::size_t bytes_;
};

/// Values that are needed for a while, not set.
template <class T>
class Scratch {
 public:
  static_assert(std::is_trivially_copyable_v<T>);
  Scratch() = default;
  explicit Scratch(std::size_t count) : values_(static_cast<T*>(take_block(count * sizeof(T)))) {}

  T* data() const { return values_.get(); }
  T& operator[](std::size_t n) const { return values_[n]; }

 private:
  struct Give {
    void operator()(T* block) const { give_block(block); }
  };
  std::unique_ptr<T[], Give> values_;
};

}  // namespace amrpic
