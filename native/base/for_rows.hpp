#pragma once

#include <Kokkos_Core.hpp>

#include "base/types.hpp"

namespace amrpic {

/// Run f(row) for rows 0 .. n-1, in any order, on Kokkos' host execution space.
template <class F>
void for_rows(LocalIndex n, F const& f) {
  Kokkos::parallel_for(Kokkos::RangePolicy<Kokkos::DefaultHostExecutionSpace>(0, n), f);
}

}  // namespace amrpic
