// The instructions of x86 processors by name, if they have vectors; nothing for others. Of AVX-512 those are used that
// set what a mask leaves out to zero, where it leaves out nothing: GCC 12 warns of the others, which begin with a value
// that is not set, once they come from a precompiled header.
#pragma once

#ifdef __AVX2__
#include <immintrin.h>
#endif

// What the vectors of doubles need of it.
#if defined(__AVX512F__) && defined(__AVX512DQ__) && defined(__AVX512VL__)
#define AMRPIC_AVX512
#endif
