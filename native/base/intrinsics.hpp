// The instructions of x86 processors by name; nothing for others.
#pragma once

#ifdef __SSE2__
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"  // a false alarm of GCC 12 about its own header
#include <immintrin.h>
#pragma GCC diagnostic pop
#endif
