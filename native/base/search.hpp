#pragma once

#include <algorithm>
#include <cstddef>

namespace amrpic {

/// The first of ascending values that is not below `value`, as of std::lower_bound. The search starts at a guess, a
/// place in [first, last], and leaves it in steps that double: it is short, and stays in few lines of the cache, where
/// the guess is good.
template <class Iterator, class T>
Iterator lower_bound_from(Iterator first, Iterator last, Iterator guess, T const& value) {
  Iterator low = guess, high = guess;
  for (std::ptrdiff_t step = 1; low != first && !(*(low - 1) < value); step *= 2)
    high = low - 1, low -= std::min(step, low - first);
  for (std::ptrdiff_t step = 1; high != last && *high < value; step *= 2)
    low = high + 1, high += std::min(step, last - high);
  return std::lower_bound(low, high, value);
}

}  // namespace amrpic
