#pragma once

#include <memory>
#include <vector>

#include "fem/operators.hpp"
#include "solver/conjugate_gradients.hpp"
#include "solver/node_multigrid.hpp"

namespace amrpic {

enum class NodePreconditioner { none, jacobi, p_multigrid, p_multigrid_by_aggregates };

struct NodeSolution {
  std::vector<Real> u;  ///< this rank's unknowns
  GradientsReport report;
};

/// Solve A u = f for the unknowns that are not `fixed`; those have `values`. All are of this rank's own nodes. The
/// residual is that of the others, and starts where they are zero. Throws SolverError, on all ranks, if A has no
/// positive entry on its diagonal for one of them. Collective.
///
/// `kept`: the multigrid of an operator near this one, on the same nodes with the same ones fixed; its coarser levels
/// serve this solve. If it is null, it is made and left there. Tight solves have one of their own.
NodeSolution solve_nodes(fem::Operator const& a, Real const* f, bool const* fixed, Real const* values,
                         NodePreconditioner preconditioner, Real tolerance, int most_iterations,
                         std::shared_ptr<NodeMultigrid>& kept);

}  // namespace amrpic
