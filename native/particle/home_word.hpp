// A brick's name in one word of a message.
#pragma once

#include <cstdint>

#include "particle/locate.hpp"

namespace amrpic {

/// Bits of a brick in a word; the highest is free. A box has at least two cells along each axis and a rank at most
/// 2^31, so that no box has 2^27 bricks.
constexpr int level_bits = 5, box_bits = 31, brick_bits = 27;
static_assert(1 + level_bits + box_bits + brick_bits == 64);

inline std::uint64_t word_of(Home const& home) {
  std::uint64_t const word = std::uint64_t(home.brick) << box_bits | std::uint64_t(home.box);
  return word << level_bits | std::uint64_t(home.level);
}

inline Home home_of(std::uint64_t word) {
  auto const bits = [](std::uint64_t of, int count) { return int(of & ((std::uint64_t(1) << count) - 1)); };
  return {bits(word, level_bits), bits(word >> level_bits, box_bits),
          bits(word >> (level_bits + box_bits), brick_bits)};
}

}  // namespace amrpic
