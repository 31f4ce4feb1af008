// The instructions of processors with vectors of 64 bytes; nothing for others.
#pragma once

#ifdef __AVX512F__
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"  // a false alarm of GCC 12 about its own header
#include <immintrin.h>
#pragma GCC diagnostic pop
#endif
