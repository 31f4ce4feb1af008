#pragma once

#include <array>
#include <type_traits>
#include <utility>

#include "base/kokkos.hpp"
#include "base/types.hpp"

namespace amrpic {

/// Along the normal of a coarse-fine face a fine ghost is quadratic: with the fine cells at -1/2 (phi_1) and -3/2
/// (phi_2) and the coarse value phi* at +1 fine cell widths from the face, the parabola gives at +1/2 ghost = 8/15 phi*
/// + 2/3 phi_1 - 1/5 phi_2.
namespace interface_ghost {
constexpr Real coarse = 8.0 / 15.0;
constexpr Real first = 2.0 / 3.0;
constexpr Real second = -1.0 / 5.0;
}  // namespace interface_ghost

template <class Value>
KOKKOS_INLINE_FUNCTION Value ghost_at_interface(Value const& star, Value const& phi_1, Value const& phi_2) {
  return interface_ghost::coarse * star + interface_ghost::first * phi_1 + interface_ghost::second * phi_2;
}

/// phi_1 less its ghost where phi* is zero.
template <class Value>
KOKKOS_INLINE_FUNCTION Value difference_at_interface(Value const& phi_1, Value const& phi_2) {
  using Weight = std::conditional_t<std::is_arithmetic_v<Value>, Value, Real>;
  return Weight(1 - interface_ghost::first) * phi_1 + Weight(-interface_ghost::second) * phi_2;
}

/// What the difference across each of four fine faces weighs in that across the coarse face that they make up: a
/// quarter of the face each, and half the distance.
constexpr Real fine_face_weight = 2.0 / 4;

/// The ghost value at a coarse face that gives the flux of the four fine ones: of the sum of their differences.
template <class Value>
inline Value ghost_at_fine_faces(Value const& inner, Value const& differences) {
  return inner + fine_face_weight * differences;
}

/// phi* behind the four fine faces of a coarse one, or weights for it: [upper half along v][upper half along u] of the
/// tangential axes.
template <class T>
using FourStars = std::array<std::array<T, 2>, 2>;

template <class T>
KOKKOS_INLINE_FUNCTION void add_to_stars(FourStars<T>& stars, FourStars<Real> const& weight, T value) {
  for (std::size_t b = 0; b < 2; ++b)
    for (std::size_t a = 0; a < 2; ++a) stars[b][a] += T(weight[b][a]) * value;
}

/// phi* as a sum over coarse cells of the interface plane: offsets from the cell behind the ghost, and weights.
struct PlaneFit {
  struct Term {
    int i, j;  ///< along the lower and the higher tangential axis
    Real weight;
  };
  std::array<Term, 9> terms;
};

/// Lagrange weight of node `first + m` of `count` neighbouring integer nodes, at x.
constexpr Real lagrange(int first, int count, int m, Real x) {
  Real weight = 1;
  for (int k = 0; k < count; ++k)
    if (k != m) weight *= (x - (first + k)) / Real(m - k);
  return weight;
}

/// Where in its parent's face a fine cell's centre lies, in coarse cell widths from the middle.
constexpr Real quarter(bool upper) { return upper ? 0.25 : -0.25; }

/// The parabola through three neighbouring values, a quarter of a spacing below the middle one: their weights from the
/// lower one up; above the middle the other way round.
constexpr std::array<Real, 3> parabola_at_quarter{
    lagrange(-1, 3, 0, quarter(false)), lagrange(-1, 3, 1, quarter(false)), lagrange(-1, 3, 2, quarter(false))};

constexpr int plane_reach = 2;  ///< how far the cells that phi* may take lie from the one behind it, along each axis

/// Lower corners of nine blocks of 3 x 3 coarse cells around the one behind the ghost, in the order in which they are
/// tried: bit patterns 473536, 14798, 236768, 15153152, 947072, 29596, 7399, 7576576, 30306304 of the 5 x 5 cells.
constexpr std::array<std::pair<int, int>, 9> plane_corners{
    {{-1, -1}, {-2, -1}, {-1, -2}, {0, -1}, {-1, 0}, {-2, 0}, {-2, -2}, {0, -2}, {0, 0}}};

/// The first of the nine blocks that is complete, -1 if none is; `is_usable(i, j)`: whether the cell at that offset
/// from the one behind the ghost exists, lies inside the domain and is uncovered.
template <class IsUsable>
constexpr int plane_placement(IsUsable&& is_usable) {
  for (std::size_t p = 0; p < plane_corners.size(); ++p) {
    bool complete = true;
    for (int n = 0; complete && n < 9; ++n)
      complete = is_usable(plane_corners[p].first + n / 3, plane_corners[p].second + n % 3);
    if (complete) return int(p);
  }
  return -1;
}

/// phi* at (x, y) coarse cell widths from the coarse cell behind the ghost: 2-D second-order Lagrange interpolation
/// (Frey and Adelmann) in one of the nine blocks. Where none is complete, `gap_fit` finds it.
inline PlaneFit plane_fit(int placement, Real x, Real y) {
  auto const [i, j] = plane_corners[std::size_t(placement)];
  PlaneFit fit;
  std::size_t t = 0;
  for (int a = 0; a < 3; ++a)
    for (int b = 0; b < 3; ++b) fit.terms[t++] = {i + a, j + b, lagrange(i, 3, a, x) * lagrange(j, 3, b, y)};
  return fit;
}

}  // namespace amrpic
