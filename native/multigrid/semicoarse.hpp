#pragma once

#include <mpi.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>

#include "multigrid/multigrid_levels.hpp"
#include "multigrid/nearly_free.hpp"

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

/// Sweeps before and after coarser corrections.
struct Sweeps {
  int before, after;
};

/// A level with fewer cells along the axes of small spacing than a refinement level of long or flat cells.
///
/// A point smoother reduces no error that is smooth along those axes, and the next coarser level, with half the cells
/// along all axes, does not resolve it where it oscillates along the others: cells of 1:1:10 took 100 cycles.
struct SemicoarsenedLevel {
  std::size_t finer;  ///< which level it corrects: the refinement level, or another semicoarsened one
  std::shared_ptr<Level const> level;
  Index3 ratio;  ///< cells of the finer level per cell
  WallGhosts walls;
  std::array<UpperEnd, 3> upper;
  std::array<LastChildren, 3> children;  ///< what last cells of the finer level weigh in the means

  /// The ghost cell where the level ends inside the domain: cell, axis, side.
  std::function<WallGhost(Index3 const&, int, int)> ghost;
  /// Factor of the last cell in the ghost that prolongation reads, at walls too.
  std::function<Real(Index3 const&, int, int)> prolonged;
};

/// The levels of a cycle, numbered as in MultigridLevels, the semicoarsened ones after these.
struct CycleLevels : MultigridLevels {
  /// Refinement levels are semicoarsened until their cells are no longer long. The cells follow from those of the level
  /// alone, not from its boxes: one is kept where corrections vanish no nearer to its centre than a quarter of its
  /// spacing.
  CycleLevels(MultigridLevels multigrid, int max_grid_size);

  std::vector<SemicoarsenedLevel> semicoarsened;

  std::size_t count() const { return levels.size() + semicoarsened.size(); }
  std::size_t finest() const { return levels.size() - 1; }
  /// A level if it is semicoarsened, else null.
  SemicoarsenedLevel const* semicoarse(std::size_t l) const {
    return l < levels.size() ? nullptr : &semicoarsened[l - levels.size()];
  }
  std::shared_ptr<Level const> const& level(std::size_t l) const {
    return l < levels.size() ? levels[l] : semicoarse(l)->level;
  }
  /// The level that level c corrects.
  std::size_t finer(std::size_t c) const { return c < levels.size() ? c + 1 : semicoarse(c)->finer; }
  /// Those that correct level l, in this order: the next coarser one, and a semicoarsened one, which also finds what
  /// the coarser correction brought in along the coarse axis.
  std::vector<std::size_t> coarser(std::size_t l) const;
  bool halves_at_most(std::size_t l) const { return semicoarse(l) || MultigridLevels::halves_at_most(l); }

  /// Sweeps on level l before coarser corrections, and after that of one of them, of those that the options name.
  ///
  /// A refinement level that has semicoarsened ones takes half of them, since these have sweeps of their own: some on
  /// either side, whatever the whole cycle does, and one more before in place of those that the level does not take. On
  /// 43 meshes of long and flat cells that took as many cycles and three quarters of the time.
  int pre_sweeps(std::size_t l, Sweeps const& chosen) const {
    return semicoarse(l) ? chosen.before + 1 : lessened(l, chosen.before);
  }
  int post_sweeps(std::size_t coarser, Sweeps const& chosen) const {
    return semicoarse(coarser) ? std::max(1, chosen.after) : lessened(finer(coarser), chosen.after);
  }

 private:
  int lessened(std::size_t l, int sweeps) const { return coarser(l).size() > 1 ? (sweeps + 1) / 2 : sweeps; }
};

}  // namespace amrpic
