#pragma once

#include <array>
#include <cstdint>

#include "base/types.hpp"

namespace amrpic {

/// Four random words from a counter and a key: Philox4x64-10 of Salmon et al., "Parallel random numbers: as easy as
/// 1, 2, 3" (SC11). There is no state, so a particle draws the same numbers on any rank and in any order.
inline std::array<std::uint64_t, 4> philox(std::array<std::uint64_t, 4> counter, std::array<std::uint64_t, 2> key) {
  __extension__ using Wide = unsigned __int128;
  for (int round = 0; round < 10; ++round) {
    Wide const a = Wide(0xD2E7470EE14C6C93u) * counter[0];
    Wide const b = Wide(0xCA5A826395121157u) * counter[2];
    counter = {std::uint64_t(b >> 64) ^ counter[1] ^ key[0], std::uint64_t(b),
               std::uint64_t(a >> 64) ^ counter[3] ^ key[1], std::uint64_t(a)};
    key[0] += 0x9E3779B97F4A7C15u;  // golden ratio
    key[1] += 0xBB67AE8584CAA73Bu;  // sqrt(3) - 1
  }
  return counter;
}

/// A number in the open interval (0, 1) from a random word: the middle of one of 2^52 equal parts.
inline Real unit_interval(std::uint64_t word) { return (Real(word >> 12) + Real(0.5)) * 0x1p-52; }

/// Fill `out` with four rows of `count` numbers in (0, 1): column n depends on id[n], `step`, `seed` and `stream`
/// alone.
inline void fill_uniforms(std::uint64_t seed, std::uint64_t stream, std::uint64_t step, std::int64_t const* id,
                          std::size_t count, Real* out) {
  for (std::size_t n = 0; n < count; ++n) {
    auto const words = philox({std::uint64_t(id[n]), step, 0, 0}, {seed, stream});
    for (std::size_t w = 0; w < 4; ++w) out[w * count + n] = unit_interval(words[w]);
  }
}

}  // namespace amrpic
