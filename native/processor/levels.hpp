// Which levels of the x86-64 psABI a processor has, in the order in which kernels are fastest on it.
#pragma once

#include <initializer_list>

namespace amrpic {

#if defined(__x86_64__)
/// Whether vectors of 512 bits gain nothing: the clock falls by as much as they are wider. Measured on Cascade Lake;
/// compilers prefer 256 bits on the same three.
inline bool slowed_by_wide_vectors() {
  return __builtin_cpu_is("skylake-avx512") || __builtin_cpu_is("cascadelake") || __builtin_cpu_is("cooperlake");
}

inline bool has_level(int level) {
  // The operating system's part, that it keeps the wide registers, is in these too.
  switch (level) {
    case 2:
      return __builtin_cpu_supports("x86-64-v2");
    case 3:
      return __builtin_cpu_supports("x86-64-v3");
    default:
      return __builtin_cpu_supports("x86-64-v4");
  }
}

/// Calls `use(level)` for each level that this processor has, the fastest first, until one call returns false.
template <class Use>
bool for_each_level(Use use) {
  __builtin_cpu_init();
  auto const of_wide = {4, 3, 2}, of_narrow = {3, 4, 2};
  for (int level : slowed_by_wide_vectors() ? of_narrow : of_wide)
    if (has_level(level) && !use(level)) return false;
  return true;
}
#else
inline bool slowed_by_wide_vectors() { return false; }

template <class Use>
bool for_each_level(Use) {
  return true;
}
#endif

}  // namespace amrpic
