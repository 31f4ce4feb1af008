#pragma once

#include <array>

#include "base/fused.hpp"
#include "base/kokkos.hpp"
#include "stencil/equation.hpp"
#include "stencil/wall_ghost.hpp"

namespace amrpic {

// Formulas are templates of the value: of numbers they are the kernels, of vectors these on several cells at once, and
// of a LinearForm they are rows of the operators.

/// a b + c of values that have no instruction of their own for it.
template <class Weight, class Value>
KOKKOS_INLINE_FUNCTION Value fused(Weight const& a, Value const& b, Value const& c) {
  return a * b + c;
}

/// What a cell's neighbours add to L phi: the weighted sum of those along x, along y and along z.
template <class Weight, class Value>
KOKKOS_INLINE_FUNCTION Value weighted_sum(std::array<Weight, 3> const& weight, Value const& x, Value const& y,
                                          Value const& z) {
  return fused(weight[2], z, fused(weight[1], y, weight[0] * x));
}

/// L phi of the value in a cell and those across its faces. Of forms the differences are taken first: terms that
/// cancel, at walls that no flux passes, do so before any rounding.
template <class Value>
KOKKOS_INLINE_FUNCTION Value laplacian(Equation const& l, Value const& c, Value const& xm, Value const& xp,
                                       Value const& ym, Value const& yp, Value const& zm, Value const& zp) {
  auto across = [&](Value const& below, Value const& above) { return (below - c) + (above - c); };
  return weighted_sum(l.weight, across(xm, xp), across(ym, yp), across(zm, zp)) - l.shift * c;
}
KOKKOS_INLINE_FUNCTION Real laplacian(Equation const& l, Real c, Real xm, Real xp, Real ym, Real yp, Real zm, Real zp) {
  return fused(-l.diagonal(), c, weighted_sum(l.weight, xm + xp, ym + yp, zm + zp));
}

/// The truncation error that a stencil of half the width makes: one of twice the width errs four times as much, so that
/// what it finds of phi less the mean of f, which the narrow one meets, is three times the error.
template <class Value>
KOKKOS_INLINE_FUNCTION Value truncation_error(Value const& wide_laplacian, Value const& mean_f) {
  return (wide_laplacian - mean_f) / 3;
}

/// What the datum of a wall across an axis weighs in the Laplacian of the cell before it.
inline Real datum_weight(Equation const& equation, int axis, WallGhost const& ghost) {
  return equation.weight[axis] * ghost.datum;
}

}  // namespace amrpic
