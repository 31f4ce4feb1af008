// Kokkos, where there is one.
#pragma once

namespace amrpic {

/// Whether this is built with Trilinos, and with the Kokkos that belongs to it.
#ifdef AMRPIC_WITHOUT_TRILINOS
constexpr bool with_trilinos = false;
#else
constexpr bool with_trilinos = true;
#endif

}  // namespace amrpic

#ifdef AMRPIC_WITHOUT_TRILINOS
#define KOKKOS_INLINE_FUNCTION inline
#else
#include <Kokkos_Macros.hpp>
#endif
