#pragma once

#include <string>

#include "cycle/relays.hpp"
#include "freespace/image.hpp"
#include "mesh/norm.hpp"
#include "stencil/intergrid.hpp"

namespace Teuchos {
class ParameterList;
}

namespace amrpic {

/// What executes the stencils.
enum class BackendKind {
  matrix_free,  ///< loops over the rows of boxes; red-black relaxation, exact bottom
  kokkos,       ///< the same as kernels over all rows of a level
  crs           ///< operators as compressed rows, and with them all that follows here
};

/// What relaxes the errors of a level.
enum class SmootherKind { red_black, jacobi, gauss_seidel, symmetric_gauss_seidel, chebyshev };

/// What solves the coarsest level: Krylov iterations by Belos, MueLu's cycles by themselves, or Amesos2's KLU2.
enum class BottomKind { gmres, cg, bicgstab, multigrid, direct };

/// What helps the bottom's iterations: Ifpack2's point methods, or MueLu by the way it aggregates.
enum class BottomPreconditioner {
  none,
  jacobi,
  gauss_seidel,  ///< forward and backward, hence symmetric
  ilu,
  smoothed_aggregation,
  plain_aggregation,
  brick_aggregation,
  structured_aggregation
};

/// What accelerates the cycles, over all levels at once.
enum class KrylovKind { none, fgmres, bicgstab };

constexpr int as_many_as_possible = 1 << 30;

/// The options of a solver; the reasons for the defaults stand beside them.
struct SolverOptions {
  Real tolerance = 1e-10;          ///< residual over right-hand side, in `norm`
  Real absolute_tolerance = 0;     ///< residual in `norm`, V/m^2 (times m^3 for l1, times m^1.5 for l2)
  bool to_discretisation = false;  ///< stop where the error left is a tenth of the estimated one of the mesh
  Norm norm = Norm::max;
  BackendKind backend = BackendKind::matrix_free;  ///< the fastest
  int order = 2;  ///< 2: of values at the cells' centres; 4: of their means, matrix-free alone
  int max_cycles = 100;
  SmootherKind smoother = SmootherKind::red_black;  ///< the fastest measured, and the same on any decomposition
  int pre_sweeps = 2, post_sweeps = 2;
  Real relaxation = 1.28;  ///< of red-black Gauss-Seidel on refined levels of cubes, see relaxation_on
  Prolongation prolongation = Prolongation::trilinear;
  Real screening = 0;        ///< kappa of -Laplace phi + kappa^2 phi = rho / eps0, 1/m
  Real3 stretch{1, 1, 1};    ///< factors on the lengths: (1, 1, gamma) is the frame of a bunch that moves along z
  freespace::Across across;  ///< walls that reflect charge which moves
  int coarse_levels = as_many_as_possible;  ///< multigrid levels below the base
  BottomKind bottom = BottomKind::gmres;    ///< works for all matrices, those of the base included
  BottomPreconditioner bottom_preconditioner = BottomPreconditioner::smoothed_aggregation;
  KrylovKind krylov = KrylovKind::none;
  int most_direct_readers = cycle::most_direct_readers;  ///< beyond them corrections pass through others
  bool neutralize =
      false;  ///< take the mean of the charge away where the boundary leaves the potential's constant free
};

/// kappa^2, of the Equation.
inline Real shift_of(SolverOptions const& options) { return options.screening * options.screening; }

/// Whether a preconditioner is one of MueLu's.
inline bool aggregates(BottomPreconditioner kind) { return kind >= BottomPreconditioner::smoothed_aggregation; }

// ---- as Trilinos names it; no other file knows the keys ----

/// Ifpack2's name of a smoother.
std::string ifpack2_name(SmootherKind kind);

/// Ifpack2's parameters of a smoother; `oscillating`: the smallest eigenvalue, over the diagonal, that it must damp.
Teuchos::ParameterList ifpack2_parameters(SolverOptions const& options, int sweeps, bool from_zero, Real oscillating);

/// Ifpack2's name of a preconditioner of the bottom, and its parameters.
std::string ifpack2_name(BottomPreconditioner kind);
Teuchos::ParameterList ifpack2_parameters(BottomPreconditioner kind);

/// MueLu's parameters of a preconditioner, for a problem of the given numbers of cells.
Teuchos::ParameterList muelu_parameters(BottomPreconditioner kind, Index3 const& cells);

/// Belos' name of the bottom's iterations, and their parameters.
std::string belos_name(BottomKind kind);
Teuchos::ParameterList belos_parameters(BottomKind kind);

}  // namespace amrpic
