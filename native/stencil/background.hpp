#pragma once

#include "base/constants.hpp"
#include "base/fused.hpp"

namespace amrpic {

/// A uniform charge that is taken away where no wall fixes the potential: `mean` + `rest`, in V/m^2.
///
/// `rest` is the mean of what is left after `mean`. It may be smaller than the rounding of `mean`, and their sum as one
/// number would lose it; so one is subtracted after the other. The first subtraction is rounded but once, relative to
/// what it leaves, so that f keeps all its digits however small it is beside the charge that was taken away.
struct Background {
  Real mean = 0, rest = 0;

  /// f = -rho / eps0 - mean - rest.
  KOKKOS_INLINE_FUNCTION Real right_hand_side(Real rho) const {
    return fused(-inverse_permittivity, rho, -mean) - rest;
  }

  static constexpr Real inverse_permittivity = 1 / vacuum_permittivity;
};

}  // namespace amrpic
