// Numbers in single precision, as many as a vector register of the processor takes; included by base/lanes.hpp.
#pragma once

#include "base/lane_types.hpp"

namespace amrpic {

/// Floats of the processor's vector registers, and those of the half of one, where these are vectors too: no operation
/// is on single numbers.
#if defined(__AVX512VL__)
constexpr int widest = 16, narrowest = 8;
#elif defined(__AVX2__)
constexpr int widest = 8, narrowest = 4;
#else
constexpr int widest = 4, narrowest = 4;
#endif

/// N numbers in a vector register, by the compiler's vector extension.
template <int N>
struct FloatLanes;

// from_left, from_right: the numbers one place lower, `low` before them, or one place higher, `high` after them.

#ifdef __AVX512VL__
template <>
struct FloatLanes<16> {
  typedef float Type __attribute__((vector_size(64)));
  typedef int Mask __attribute__((vector_size(64)));
  static constexpr Mask numbers{0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
  // one instruction, where the compiler takes one with a table
  static Type from_left(Type low, Type a) {
    return (Type)_mm512_maskz_alignr_epi32(0xffff, (__m512i)a, (__m512i)low, 15);
  }
  static Type from_right(Type a, Type high) {
    return (Type)_mm512_maskz_alignr_epi32(0xffff, (__m512i)high, (__m512i)a, 1);
  }
  static Type even(Type a, Type b) {
    return __builtin_shufflevector(a, b, 0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
  }
  static Type odd(Type a, Type b) {
    return __builtin_shufflevector(a, b, 1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23, 25, 27, 29, 31);
  }
  static Type interleave_low(Type a, Type b) {
    return __builtin_shufflevector(a, b, 0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23);
  }
  static Type interleave_high(Type a, Type b) {
    return __builtin_shufflevector(a, b, 8, 24, 9, 25, 10, 26, 11, 27, 12, 28, 13, 29, 14, 30, 15, 31);
  }
};
#endif

#ifdef __AVX2__
template <>
struct FloatLanes<8> {
  typedef float Type __attribute__((vector_size(32)));
  typedef int Mask __attribute__((vector_size(32)));
  static constexpr Mask numbers{0, 1, 2, 3, 4, 5, 6, 7};
#ifdef __AVX512VL__
  static Type from_left(Type low, Type a) { return (Type)_mm256_alignr_epi32((__m256i)a, (__m256i)low, 7); }
  static Type from_right(Type a, Type high) { return (Type)_mm256_alignr_epi32((__m256i)high, (__m256i)a, 1); }
#else  // of each half, and between these
  static Type from_left(Type low, Type a) {
    __m256i const middle = _mm256_permute2x128_si256((__m256i)low, (__m256i)a, 0x21);
    return (Type)_mm256_alignr_epi8((__m256i)a, middle, 12);
  }
  static Type from_right(Type a, Type high) {
    __m256i const middle = _mm256_permute2x128_si256((__m256i)a, (__m256i)high, 0x21);
    return (Type)_mm256_alignr_epi8(middle, (__m256i)a, 4);
  }
#endif
  static Type even(Type a, Type b) { return __builtin_shufflevector(a, b, 0, 2, 4, 6, 8, 10, 12, 14); }
  static Type odd(Type a, Type b) { return __builtin_shufflevector(a, b, 1, 3, 5, 7, 9, 11, 13, 15); }
  static Type interleave_low(Type a, Type b) { return __builtin_shufflevector(a, b, 0, 8, 1, 9, 2, 10, 3, 11); }
  static Type interleave_high(Type a, Type b) { return __builtin_shufflevector(a, b, 4, 12, 5, 13, 6, 14, 7, 15); }
};
#endif

template <>
struct FloatLanes<4> {
  typedef float Type __attribute__((vector_size(16)));
  typedef int Mask __attribute__((vector_size(16)));
  static constexpr Mask numbers{0, 1, 2, 3};
  static Type from_left(Type low, Type a) { return __builtin_shufflevector(low, a, 3, 4, 5, 6); }
  static Type from_right(Type a, Type high) { return __builtin_shufflevector(a, high, 1, 2, 3, 4); }
  static Type even(Type a, Type b) { return __builtin_shufflevector(a, b, 0, 2, 4, 6); }
  static Type odd(Type a, Type b) { return __builtin_shufflevector(a, b, 1, 3, 5, 7); }
  static Type interleave_low(Type a, Type b) { return __builtin_shufflevector(a, b, 0, 4, 1, 5); }
  static Type interleave_high(Type a, Type b) { return __builtin_shufflevector(a, b, 2, 6, 3, 7); }
};

template <int N>
typename FloatLanes<N>::Type load(float const* from) {
  return load<typename FloatLanes<N>::Type>(from);
}

template <int N>
typename FloatLanes<N>::Type all(float value) {
  return value - typename FloatLanes<N>::Type{};
}

}  // namespace amrpic
