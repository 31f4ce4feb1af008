// Cells whose arms, the segments to the centres of their neighbours, are cut by the surface of a conductor.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>

#include "base/kokkos.hpp"
#include "stencil/equation.hpp"

namespace amrpic {

/// The values at both ends of a cell's arms along one axis, what lies between them being a parabola through these and
/// the centre (Shortley and Weller, J. Appl. Phys. 9, 334, 1938). In units of the spacing; an arm that nothing cuts has
/// the length 1.
struct ArmPair {
  Real lower = 1, upper = 1;  ///< lengths, in (0, 1]

  // Factors of the values at the lower end, at the upper end and, with a minus sign, at the centre.
  std::array<Real, 3> second_difference() const {
    Real const whole = lower + upper;
    return {2 / (lower * whole), 2 / (upper * whole), 2 / (lower * upper)};
  }
  std::array<Real, 3> slope() const {  ///< at the centre
    Real const whole = lower + upper;
    return {-upper / (lower * whole), lower / (upper * whole), (lower - upper) / (lower * upper)};
  }
  /// Of the value one spacing beyond the centre on a side, less that at the centre: the difference across a face.
  std::array<Real, 3> across(int side) const {
    auto const first = slope(), second = second_difference();
    std::array<Real, 3> out;
    for (std::size_t n = 0; n < 3; ++n) out[n] = (side == 0 ? -first[n] : first[n]) + second[n] / 2;
    return out;
  }
};

/// What lies at the ends of a cell's arms along an axis, and in it.
struct ArmValues {
  ArmPair arms;
  Real lower, upper, centre;

  Real slope() const { return combined(arms.slope()); }  ///< at the centre, per spacing
  /// The value one spacing beyond the centre less that at it.
  Real across(int side) const { return combined(arms.across(side)); }

 private:
  Real combined(std::array<Real, 3> const& factor) const {
    return factor[0] * lower + factor[1] * upper - factor[2] * centre;
  }
};

constexpr Real wall_arm = 0.5;  ///< length of an arm to a wall of the domain

/// The arm of a cell towards a side.
struct Arm {
  Real length = 1;  ///< to the surface that cuts it; 1 where none does
  bool is_cut = false;
  Real first = 0;            ///< behind a face of the level: what the ghost takes of the cell itself
  bool is_parabola = false;  ///< the ghost lies on one through a wall, the cell and the next one inside
};

/// The equation of a cut cell: the sum over its neighbours, and over the surfaces at its arms, less `diagonal` times
/// its own value. It is that of the Laplacian times a factor of at most one, `scale`, so that no diagonal exceeds that
/// of other cells: a short arm makes a large one, and its residual restricted would drown those beside it.
struct CutRow {
  std::array<Real, 6>
      factor{};  ///< of what lies beyond each side, or of the potential of the surface, or the wall, there
  Real diagonal = 0, scale = 1;
  Real at_surfaces = 0;       ///< the sum of the factors of surfaces
  std::uint8_t surfaces = 0;  ///< one bit for each side

  KOKKOS_INLINE_FUNCTION bool has_surface(std::size_t side) const { return surfaces >> side & 1; }
  KOKKOS_INLINE_FUNCTION Real neighbour(std::size_t side) const { return has_surface(side) ? 0 : factor[side]; }
  KOKKOS_INLINE_FUNCTION Real surface(std::size_t side) const { return has_surface(side) ? factor[side] : 0; }
};

/// `hold`: of thin metal, over the diagonal of other cells.
inline CutRow cut_row(Equation const& equation, std::array<Arm, 6> const& arms, Real hold = 0) {
  CutRow out;
  Real of_metal = equation.shift + hold * equation.diagonal();
  out.diagonal = of_metal;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    std::array<Arm, 2> side{arms[2 * axis], arms[2 * axis + 1]};
    of_metal += equation.weight[axis] * ArmPair{side[0].length, side[1].length}.second_difference()[2];
    for (std::size_t s = 0; s < 2; ++s)  // its parabola would go through the surface
      if (side[s].is_parabola && !side[s].is_cut && side[1 - s].is_cut) side[s] = {wall_arm, true, 0, false};
    auto const factor = ArmPair{side[0].length, side[1].length}.second_difference();
    Real const weight = equation.weight[axis];
    out.diagonal += weight * factor[2];
    for (std::size_t s = 0; s < 2; ++s) {
      out.factor[2 * axis + s] = weight * factor[s];
      if (side[s].is_cut)
        out.surfaces = std::uint8_t(out.surfaces | 1 << (2 * axis + s)), out.at_surfaces += weight * factor[s];
      else
        out.diagonal -= weight * factor[s] * side[s].first;
    }
  }
  out.scale = std::min(Real(1), equation.diagonal() / of_metal);
  for (Real& factor : out.factor) factor *= out.scale;
  out.diagonal *= out.scale;
  out.at_surfaces *= out.scale;
  return out;
}

}  // namespace amrpic
