#include "base/huge_pages.hpp"

#include <cstdint>

#ifdef __linux__
#include <sys/mman.h>
#endif

namespace amrpic {

void advise_huge_pages([[maybe_unused]] void* block, [[maybe_unused]] std::size_t bytes) {
#ifdef __linux__
  constexpr std::size_t small_page = 4096, least = std::size_t(1) << 22;
  if (bytes < least) return;
  std::size_t const skipped = (small_page - reinterpret_cast<std::uintptr_t>(block) % small_page) % small_page;
  madvise(static_cast<char*>(block) + skipped, bytes - skipped, MADV_HUGEPAGE);
#endif
}

}  // namespace amrpic
