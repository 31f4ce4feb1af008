#pragma once

#include <array>
#include <memory>
#include <optional>
#include <vector>

#include "mesh/exchange.hpp"
#include "mesh/hierarchy.hpp"
#include "operators/crs.hpp"
#include "stencil/boundary.hpp"
#include "stencil/coarse_end.hpp"
#include "stencil/equation.hpp"
#include "stencil/intergrid.hpp"

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

/// Cells of other ranks that the rows of a level's operators name, ascending, by the level of the columns.
struct RemoteCells {
  std::vector<GlobalIndex> coarse, own, fine;
};

/// The eight operators of a level. The Laplacians approximate +Laplace, in 1/m^2.
struct LevelOperators {
  std::shared_ptr<Level const> level;
  WallGhosts walls;
  Real3 last_width{1, 1, 1};  ///< of last cells, see `UpperEnd`
  Exchange halo;              ///< all cells of this level that any operator reads: numbering of its vectors
  Exchange stencil_halo;      ///< the part of it that `no_fine` reads

  Crs no_fine;
  std::optional<Crs> own_composite;      ///< kept apart only where a finer level exists
  Crs coarse_boundary;                   ///< columns: next coarser level
  Crs fine_boundary;                     ///< columns: next finer level
  Crs restriction;                       ///< rows of covered cells; columns: next finer level
  Crs prolongation;                      ///< columns: next coarser level
  std::vector<char> uncovered;           ///< diagonal of the eighth operator: 1 where no finer level covers the cell
  std::array<GradientAxis, 3> gradient;  ///< empty until assemble_gradient
  bool has_gradient = false;
  RemoteCells reads;  ///< by the operators but the gradient

  Crs const& composite() const { return own_composite ? *own_composite : no_fine; }
  LocalIndex rows() const { return level->local_cells(); }
  std::size_t bytes() const;
};

/// A column of levels for which operators are made, coarse to fine: multigrid levels, each of which covers the domain,
/// up to and including the base, then the refinement levels.
struct LevelStack {
  std::vector<std::shared_ptr<Level const>> levels;
  std::vector<Index3> ratio;  ///< [l]: cells of level l per cell of level l - 1; 2 on refinement levels
  std::vector<WallGhosts> walls;
  std::vector<std::array<UpperEnd, 3>> upper;  ///< [l][axis]
  std::array<std::array<Boundary, 2>, 3> boundary;
  std::size_t base = 0;  ///< the base level's place
  Real shift = 0;        ///< kappa^2 of the screened equation, in 1/m^2

  Equation equation(std::size_t l) const { return equation_on(levels[l]->spacing(), shift); }

  bool refines(std::size_t l) const { return l > base && l < levels.size(); }
  /// Whether the next coarser level may be of like size: a coarser one than a refinement level, or than a level with
  /// half its cells along one axis alone. An F-cycle over such levels costs more than it saves.
  bool halves_at_most(std::size_t l) const {
    return refines(l) || (l > 0 && ratio[l][0] * ratio[l][1] * ratio[l][2] == 2);
  }
};

/// The refinement levels alone. Multigrid levels are put below them by `coarsen_below`.
LevelStack stack_of(Hierarchy const& hierarchy, Real shift);

/// Operators of the levels of a stack, coarse to fine; several solvers may share those of a level.
using StackOperators = std::vector<std::shared_ptr<LevelOperators>>;

/// A stack and its operators, from which those of another stack on the same domain can be taken.
struct Assembled {
  LevelStack stack;
  Prolongation prolongation = Prolongation::trilinear;
  StackOperators operators;
  int made = 0;  ///< number of levels whose operators were not taken over
};

/// All operators of a stack but the gradient, counted and filled directly. Those of levels that lie in `former` as they
/// are, with the same neighbours in the stack, are taken over; the others are let go before new ones take memory.
/// Collective.
Assembled assemble(MPI_Comm comm, LevelStack const& stack, Prolongation prolongation, Assembled former = {});

/// Add the three axes of the gradient to those operators of a stack that lack them. Local.
void assemble_gradient(LevelStack const& stack, StackOperators const& operators);

/// The three axes of E = -grad phi in the covered cells of level l, by differences between cells of that level alone;
/// other rows are empty. Local.
std::array<Crs, 3> assemble_covered_gradient(LevelStack const& stack, std::size_t l, LevelOperators const& operators);

}  // namespace amrpic
