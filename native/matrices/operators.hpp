#pragma once

#include <array>
#include <memory>
#include <optional>
#include <vector>

#include "base/communicator.hpp"
#include "matrices/sparse_matrix.hpp"
#include "mesh/metal.hpp"
#include "multigrid/multigrid_levels.hpp"

namespace amrpic {

/// One axis of E = -grad phi at the centres of uncovered cells: own phi_l + coarse phi_(l-1) + fine phi_(l+1), plus
/// walls.
struct GradientAxis {
  SparseMatrix own, coarse, fine;
};

/// The eight operators of a level. The Laplacians approximate +Laplace, in 1/m^2.
struct LevelOperators {
  std::shared_ptr<Level const> level;
  std::shared_ptr<LevelCells const> cells;  ///< rows of these operators, and what any operator reads of this level
  WallGhosts walls;
  Real3 last_width{1, 1, 1};  ///< of last cells, see `UpperEnd`

  SparseMatrix no_fine;
  std::optional<SparseMatrix> own_composite;  ///< kept apart only where a finer level exists, or metal
  SparseMatrix coarse_boundary;               ///< columns: next coarser level
  SparseMatrix fine_boundary;                 ///< columns: next finer level
  SparseMatrix restriction;                   ///< rows of covered cells; columns: next finer level
  SparseMatrix prolongation;                  ///< columns: next coarser level
  std::vector<char> uncovered;           ///< diagonal of the eighth operator: 1 where no finer level covers the cell
  std::array<GradientAxis, 3> gradient;  ///< empty until assemble_gradient
  bool has_gradient = false;
  bool has_gaps = false;  ///< rows of this rank have fits in narrow gaps, which depend on the two next finer levels

  SparseMatrix const& composite() const { return own_composite ? *own_composite : no_fine; }
  LocalIndex rows() const { return level->local_cells(); }
  std::size_t bytes() const;
};

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
/// has with the same neighbouring levels are reused; the others are freed before new ones take memory. `metal`: null if
/// there is none; cut cells have their equations scaled, see CutRow, and solid ones have none but in `no_fine`, where
/// they are held at zero. Collective.
Assembled assemble(Communicator const& comm, MultigridLevels const& multigrid, Prolongation prolongation,
                   Assembled former = {}, Metal const* metal = nullptr);

/// Add the three axes of the gradient to those operators that lack them. Collective.
void assemble_gradient(MultigridLevels const& multigrid, MultigridOperators const& operators);

}  // namespace amrpic
