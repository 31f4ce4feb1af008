// Kokkos, where there is one: that of Trilinos, or one by itself.
#pragma once

#ifndef AMRPIC_WITHOUT_TRILINOS
#define AMRPIC_WITH_KOKKOS
#endif

#ifdef AMRPIC_WITH_KOKKOS
#include <Kokkos_Macros.hpp>
#else
#define KOKKOS_INLINE_FUNCTION inline
#define KOKKOS_FORCEINLINE_FUNCTION inline __attribute__((always_inline))
#endif
