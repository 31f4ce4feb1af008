#include "particle/array_pool.hpp"

#include "base/pool.hpp"

namespace amrpic {

namespace {

/// Half as much again as is in use: what one step needs besides the arrays that outlive it. Never destroyed: Python may
/// drop its last array after the program's static objects are gone.
Pool& pool() {
  static Pool* const the_one = new Pool(1.5);
  return *the_one;
}

}  // namespace

void* take_block(std::size_t bytes) { return pool().take(bytes); }
void give_block(void* block) noexcept { pool().give(block); }
std::size_t idle_bytes() { return pool().idle(); }

ReservedMemory::ReservedMemory(std::size_t bytes) : bytes_(bytes) { pool().reserve(bytes); }
ReservedMemory::~ReservedMemory() { pool().end_reserve(bytes_); }

}  // namespace amrpic
