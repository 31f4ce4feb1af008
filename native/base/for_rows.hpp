#pragma once

#include "base/kokkos.hpp"
#include "base/types.hpp"
#ifdef AMRPIC_WITH_KOKKOS
#include <Kokkos_Core.hpp>
#endif

namespace amrpic {

/// Run f(row) for rows 0 .. n-1, in any order, on Kokkos' host execution space where there is Kokkos.
template <class F>
void for_rows(LocalIndex n, F const& f) {
#ifdef AMRPIC_WITH_KOKKOS
  Kokkos::parallel_for(Kokkos::RangePolicy<Kokkos::DefaultHostExecutionSpace>(0, n), f);
#else
  for (LocalIndex row = 0; row < n; ++row) f(row);
#endif
}

}  // namespace amrpic
