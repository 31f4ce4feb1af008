#pragma once

#include <array>
#include <memory>
#include <optional>
#include <vector>

#include "base/communicator.hpp"
#include "mesh/halo.hpp"
#include "mesh/hierarchy.hpp"
#include "operators/crs.hpp"
#include "operators/stencil_cells.hpp"
#include "stencil/boundary.hpp"
#include "stencil/equation.hpp"
#include "stencil/intergrid.hpp"
#include "stencil/odd_extents.hpp"

namespace amrpic {

/// One axis of E = -grad phi at the centres of uncovered cells: own phi_l + coarse phi_(l-1) + fine phi_(l+1), plus
/// walls.
struct GradientAxis {
  Crs own, coarse, fine;
};

/// What E holds in covered cells.
enum class CoveredField {
  mean,       ///< of the children, as in all fields
  difference  ///< of phi, whose covered cells hold the means: what clouds as wide as these cells feel
};

/// The eight operators of a level. The Laplacians approximate +Laplace, in 1/m^2.
struct LevelOperators {
  std::shared_ptr<Level const> level;
  WallGhosts walls;
  Real3 last_width{1, 1, 1};  ///< of last cells, see `UpperEnd`
  Halo halo;                  ///< all cells of this level that any operator reads: numbering of its vectors
  Halo stencil_halo;          ///< the part of it that `no_fine` reads

  Crs no_fine;
  std::optional<Crs> own_composite;      ///< kept apart only where a finer level exists
  Crs coarse_boundary;                   ///< columns: next coarser level
  Crs fine_boundary;                     ///< columns: next finer level
  Crs restriction;                       ///< rows of covered cells; columns: next finer level
  Crs prolongation;                      ///< columns: next coarser level
  std::vector<char> uncovered;           ///< diagonal of the eighth operator: 1 where no finer level covers the cell
  std::array<GradientAxis, 3> gradient;  ///< empty until assemble_gradient
  bool has_gradient = false;
  bool has_gaps = false;  ///< rows of this rank have fits in narrow gaps, which depend on the two next finer levels

  Crs const& composite() const { return own_composite ? *own_composite : no_fine; }
  LocalIndex rows() const { return level->local_cells(); }
  std::size_t bytes() const;
};

/// Levels for which operators are made, coarse to fine: up to and including the base each covers the domain; then come
/// the refinement levels.
struct MultigridLevels {
  std::vector<std::shared_ptr<Level const>> levels;
  std::vector<std::shared_ptr<LevelFaces const>> faces;  ///< [l], of the base and finer levels; null on coarser ones
  std::vector<Index3> ratio;  ///< [l]: cells of level l per cell of level l - 1; 2 on refinement levels
  /// [l]: whether level l - 1 covers the domain with the parents of each box of level l in the box of the same number,
  /// on the same rank.
  std::vector<char> parents_in_place;
  std::vector<WallGhosts> walls;
  std::vector<std::array<UpperEnd, 3>> upper;  ///< [l][axis]
  std::array<std::array<Boundary, 2>, 3> boundary;
  std::size_t base = 0;  ///< the base level's place
  Real shift = 0;        ///< kappa^2 of the screened equation, in 1/m^2

  Equation equation(std::size_t l) const { return equation_on(levels[l]->spacing(), shift); }

  bool refines(std::size_t l) const { return l > base && l < levels.size(); }
  /// The levels that l refines and that refine it.
  LevelsBeside beside(std::size_t l) const {
    auto const finer = [&](std::size_t f) { return refines(f) ? levels[f].get() : nullptr; };
    return {refines(l) ? levels[l - 1].get() : nullptr, finer(l + 1), finer(l + 2)};
  }
  /// Whether the next coarser level may be of like size: a coarser one than a refinement level, or than a level with
  /// half its cells along one axis alone. An F-cycle over such levels costs more than it saves.
  bool halves_at_most(std::size_t l) const {
    return refines(l) || (l > 0 && ratio[l][0] * ratio[l][1] * ratio[l][2] == 2);
  }
};

/// The base and the refinement levels; `coarsen_below` adds coarser ones.
MultigridLevels refinement_levels(Hierarchy const& hierarchy, Real shift);

/// Operators of multigrid levels, coarse to fine; several solvers may share those of a level.
using MultigridOperators = std::vector<std::shared_ptr<LevelOperators>>;

/// Multigrid levels and their operators, which may serve other multigrid levels on the same domain.
struct Assembled {
  MultigridLevels multigrid;
  Prolongation prolongation = Prolongation::trilinear;
  MultigridOperators operators;
  int made = 0;  ///< number of levels whose operators were not taken over
};

/// All operators of multigrid levels except the gradient, counted and filled directly. Those of levels that `former`
/// has with the same neighbouring levels are reused; the others are freed before new ones take memory. Collective.
Assembled assemble(Communicator const& comm, MultigridLevels const& multigrid, Prolongation prolongation,
                   Assembled former = {});

/// Add the three axes of the gradient to those operators that lack them. Local.
void assemble_gradient(MultigridLevels const& multigrid, MultigridOperators const& operators);

/// The three axes of E = -grad phi in the covered cells of level l, by differences between cells of that level alone;
/// other rows are empty. Local.
std::array<Crs, 3> assemble_covered_gradient(MultigridLevels const& multigrid, std::size_t l,
                                             LevelOperators const& operators);

}  // namespace amrpic
