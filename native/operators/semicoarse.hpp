#pragma once

#include <mpi.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>

#include "operators/multigrid_levels.hpp"
#include "operators/nearly_free.hpp"

namespace amrpic {

/// Over-relaxation, less one, that is best where the potential is screened, over that where it is not: 2 / (1 + sqrt(1
/// - r^2)) - 1 with the factor r by which a Jacobi step multiplies errors that vary along one axis of three (Yavneh,
/// SIAM J. Sci. Comput. 17, 180, 1996), on cells of twice the width. So it was best on nested levels for kappa h from
/// 0.25 to 10.
inline Real screened_relaxation(Real3 const& spacing, Real shift) {
  auto best = [](Real r) { return 2 / (1 + std::sqrt(1 - r * r)) - 1; };
  Equation const wide = equation_on({2 * spacing[0], 2 * spacing[1], 2 * spacing[2]}, shift);
  constexpr Real unscreened = 4.0 / 6;
  return best(unscreened * (wide.diagonal() - shift) / wide.diagonal()) / best(unscreened);
}

/// Whether errors couple along one axis alone: all others along which a level has cells have larger spacings.
inline bool has_flat_cells(Level const& level) {
  Real shortest = std::numeric_limits<Real>::infinity(), next = shortest;
  for (int d = 0; d < 3; ++d) {
    if (level.domain().extent(d) == 1) continue;
    next = std::min(next, std::max(shortest, level.spacing()[d]));
    shortest = std::min(shortest, level.spacing()[d]);
  }
  return has_long_cells(level) && next > 1.5 * shortest;
}

/// The over-relaxation on a level, of that for cubes in a V-cycle. The best one lies closer to one where cells are
/// long, since errors couple along two axes, and below one where they couple along one alone. It is closer to one also
/// in an F-cycle, which leaves less of those errors that over-relaxing makes up for, and where the potential is
/// screened.
inline Real relaxation_on(Level const& level, Real shift, bool v_cycle, Real relaxation) {
  Real const of_shape = has_flat_cells(level) ? -0.3 : has_long_cells(level) ? 0.55 : 1;
  return 1 + (v_cycle ? 1 : 0.7) * of_shape * screened_relaxation(level.spacing(), shift) * (relaxation - 1);
}

/// Sweeps before and after a coarser correction.
struct Sweeps {
  int before, after;
};

/// Sweeps on a level that has copies, before a cycle over these and before the next coarser level's correction, of so
/// many where there is none: the cycle has sweeps of its own. On 43 meshes of long and flat cells half of them, and one
/// more on the copies, took as many cycles and three quarters of the time.
inline int beside_local_cycle(int sweeps) { return (sweeps + 1) / 2; }

/// Sweeps on copies, of those that the options name; after their corrections the level itself takes as many. Copies
/// need some on either side, whatever the whole cycle does, and one more before in place of those that the level does
/// not take.
inline Sweeps sweeps_of_copies(Sweeps const& chosen) { return {chosen.before + 1, std::max(1, chosen.after)}; }

/// A copy of a refinement level with fewer cells along the axes of small spacing, on which corrections that are smooth
/// there are found.
struct LevelCopy {
  std::shared_ptr<Level const> level;
  Index3 ratio;  ///< cells of the level above, the copy before it or the refinement level itself, per cell
  WallGhosts walls;
  std::array<UpperEnd, 3> upper;
  std::array<LastChildren, 3> children;  ///< what last cells above weigh in the means

  /// The ghost cell where the copy ends inside the domain: cell, axis, side.
  std::function<WallGhost(Index3 const&, int, int)> ghost;
  /// Factor of the last cell in the ghost that prolongation reads, at walls too.
  std::function<Real(Index3 const&, int, int)> prolonged;
};

/// The copies of a refinement level, finer ones first, until their cells are no longer long; none for cells that are
/// not.
///
/// The cells of a copy follow from those of the level alone, not from its boxes: one is kept where corrections vanish
/// no nearer to its centre than a quarter of its spacing. `walls` are those of the level.
std::vector<LevelCopy> semicoarse_copies(std::shared_ptr<Level const> const& level, WallGhosts const& walls,
                                         Faces const& boundary, int max_grid_size);

}  // namespace amrpic
