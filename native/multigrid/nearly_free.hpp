#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "mesh/level.hpp"
#include "stencil/equation.hpp"
#include "stencil/odd_extents.hpp"

namespace amrpic {

using Faces = std::array<std::array<Boundary, 2>, 3>;  ///< [axis][lower or upper]

/// The smallest eigenvalue of -L on a level that covers the domain, 1/m^2, in which constants do not count where they
/// are in the null space.
inline Real smallest_eigenvalue(Level const& level, Faces const& boundary, Real shift) {
  Real held = shift, next = std::numeric_limits<Real>::infinity();
  for (int d = 0; d < 3; ++d) {
    auto const is_wall = [](Boundary kind) { return kind == Boundary::dirichlet || kind == Boundary::open; };
    int const walls = is_wall(boundary[d][0]) + is_wall(boundary[d][1]);
    Real const half_wave = M_PI / (level.domain().extent(d) * level.spacing()[d]);
    if (walls > 0)
      held += half_wave * half_wave * walls * walls / 4;
    else
      next = std::min(next, half_wave * half_wave * (boundary[d][0] == Boundary::periodic ? 4 : 1));
  }
  return held > 0 ? held : next;
}

/// Whether single precision does not see what the equation says of the smoothest potential that it holds.
///
/// Rounded, a potential that is large beside its differences leaves a residual of epsilon times the diagonal. If that
/// is summed over cells and taken for a right-hand side of the smoothest potential, what comes of it is larger by the
/// diagonal over the smallest eigenvalue. Differences between neighbours, which are exact, do not have that part.
inline bool is_nearly_free(Level const& level, Faces const& boundary, Real shift) {
  constexpr Real most = 1e5;
  return equation_on(level.spacing(), shift).diagonal() > most * smallest_eigenvalue(level, boundary, shift);
}

/// Whether the mean of phi is left to the sum over all cells, in which fluxes cancel: where nothing holds it, or
/// screening alone, and that weakly. The coarsest level then leaves it as it is: made of what single precision rounds
/// of a residual, it would be up to the diagonal over the shift times that, and what it rounds of all others would
/// slow the cycles.
inline bool is_mean_left_free(Level const& level, Faces const& boundary, Real shift) {
  for (auto const& ends : boundary)
    if (!is_closed(ends)) return false;
  return shift == 0 || is_nearly_free(level, boundary, shift);
}

}  // namespace amrpic
