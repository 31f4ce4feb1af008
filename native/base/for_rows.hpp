#pragma once

#include "base/kokkos.hpp"
#include "base/types.hpp"
#ifndef AMRPIC_WITHOUT_TRILINOS
#include <Kokkos_Core.hpp>
#endif

namespace amrpic {

/// Run f(row) for rows 0 .. n-1, in any order, on Kokkos' host execution space where there is Kokkos.
template <class F>
void for_rows(LocalIndex n, F const& f) {
#ifdef AMRPIC_WITHOUT_TRILINOS
  for (LocalIndex row = 0; row < n; ++row) f(row);
#else
  Kokkos::parallel_for(Kokkos::RangePolicy<Kokkos::DefaultHostExecutionSpace>(0, n), f);
#endif
}

}  // namespace amrpic
