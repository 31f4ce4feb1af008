// Eight particles at a time, in GCC's vector types: the compiler splits them into the vectors that the processor has,
// so one text serves all, and rounds alike on all.
#pragma once

#include <cstdint>
#include <cstring>

#ifdef __AVX512F__
#include <immintrin.h>
#endif

#include "base/types.hpp"

// How vectors are passed matters between object files built for different processors; here all is inlined.
#pragma GCC diagnostic ignored "-Wpsabi"

namespace amrpic {

constexpr int lane_count = 8;

typedef Real Lanes __attribute__((vector_size(8 * lane_count)));
typedef std::int64_t WideLanes
    __attribute__((vector_size(8 * lane_count)));  ///< also a comparison: all bits set, or none
typedef std::int32_t IndexLanes __attribute__((vector_size(4 * lane_count)));

constexpr WideLanes lane_number = {0, 1, 2, 3, 4, 5, 6, 7};

template <class Vector>
inline Vector load(void const* from) {
  Vector out;
  std::memcpy(&out, from, sizeof out);
  return out;
}

template <class Vector>
inline void store(void* to, Vector const& values) {
  std::memcpy(to, &values, sizeof values);
}

/// Write eight numbers to the start of a cache line that will not be read soon, past the cache where that can be done:
/// the line is not read from memory first, and nothing else is displaced. `stream_end` must follow before others read.
inline void stream(Real* to, Lanes const& values) {
#ifdef __AVX512F__
  _mm512_stream_pd(to, (__m512d)values);
#else
  store(to, values);
#endif
}
inline void stream_end() {
#ifdef __AVX512F__
  _mm_sfence();
#endif
}

/// The values at eight places. One by one: where processors mend the leak of gather instructions, these wait for each
/// other.
inline Lanes pick(Real const* from, LocalIndex const* n) {
  return Lanes{from[n[0]], from[n[1]], from[n[2]], from[n[3]], from[n[4]], from[n[5]], from[n[6]], from[n[7]]};
}

template <class To, class From>
inline To convert(From const& values) {
  return __builtin_convertvector(values, To);
}

}  // namespace amrpic
