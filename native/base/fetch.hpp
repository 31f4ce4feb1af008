// Memory that is asked for before it is used.
#pragma once

#include <cstddef>

namespace amrpic {

enum class Use { read, write };

/// Ask for n values to be brought near, to be read or written. Any address will do.
template <Use use, class T>
inline void fetch(T const* first, std::ptrdiff_t n) {
  constexpr std::ptrdiff_t line = 64 / sizeof(T);
  for (std::ptrdiff_t i = 0; i < n; i += line) __builtin_prefetch(first + i, use == Use::write);
}

/// Values of a page. Processors foresee what follows within one, so what is passed through in order is asked for at
/// most so far ahead.
template <class T>
constexpr std::ptrdiff_t page = 4096 / sizeof(T);

}  // namespace amrpic
