#pragma once

#include "base/kokkos.hpp"
#include "base/types.hpp"

namespace amrpic {

/// L phi = Laplace phi - shift phi on cells of equal size: the weights of the second differences, 1 / h^2 along each
/// axis, and kappa^2 of the screened equation; in 1/m^2.
struct Equation {
  Real3 weight;
  Real shift = 0;

  KOKKOS_INLINE_FUNCTION Real diagonal() const { return 2 * (weight[0] + weight[1] + weight[2]) + shift; }
};

inline Equation equation_on(Real3 const& spacing, Real shift) {
  return {{1 / spacing[0] / spacing[0], 1 / spacing[1] / spacing[1], 1 / spacing[2] / spacing[2]}, shift};
}

/// The same equation times a factor.
inline Equation scaled(Equation const& l, Real factor) {
  return {{factor * l.weight[0], factor * l.weight[1], factor * l.weight[2]}, factor * l.shift};
}

}  // namespace amrpic
