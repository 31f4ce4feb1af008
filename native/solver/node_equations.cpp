#include "solver/node_equations.hpp"

#include <algorithm>
#include <memory>
#include <string>

#include "base/error.hpp"

namespace amrpic {

namespace {

/// Tolerances from which on solves of uneven elements are worth their factors. Newton's loose solves are not, and pass
/// states that are hardly stable more easily without.
constexpr Real tight = 1e-6;

/// Reciprocals of the diagonal, zeros where unknowns are fixed. Collective.
std::vector<Real> inverse_diagonal(fem::Operator const& a, bool const* fixed) {
  auto out = a.diagonal();
  GlobalIndex empty = 0;
  for (std::size_t i = 0; i < out.size(); ++i) {
    if (!fixed[i] && !(out[i] > 0)) ++empty;
    out[i] = fixed[i] || !(out[i] > 0) ? 0 : 1 / out[i];
  }
  empty = a.points().lattice().comm().sum(empty);
  if (empty > 0)
    throw SolverError("no point says anything about " + std::to_string(empty) +
                      " unknowns, as their nodes' elements have none; fix these nodes or put points there");
  return out;
}

}  // namespace

NodeSolution solve_nodes(fem::Operator const& a, Real const* f, bool const* fixed, Real const* values,
                         NodePreconditioner preconditioner, Real tolerance, int most_iterations,
                         std::shared_ptr<NodeMultigrid>& kept) {
  std::size_t const n = a.unknowns();
  auto inverse = inverse_diagonal(a, fixed);
  auto const free_part = [&](std::vector<Real>& v) {
    for (std::size_t i = 0; i < n; ++i)
      if (fixed[i]) v[i] = 0;
  };
  bool const by_halves = preconditioner == NodePreconditioner::p_multigrid;
  std::shared_ptr<NodeMultigrid> multigrid;
  if (by_halves || preconditioner == NodePreconditioner::p_multigrid_by_aggregates) {
    if (kept && tolerance > tight) {
      multigrid = kept;
      multigrid->smooth_for(a, std::move(inverse));
    } else {
      multigrid = std::make_shared<NodeMultigrid>(
          a, std::move(inverse), by_halves ? CornerCycle::halving : CornerCycle::aggregation, tolerance <= tight);
      if (tolerance > tight) kept = multigrid;
    }
  }
  NodeSolution out;
  out.u.assign(n, 0);
  for (std::size_t i = 0; i < n; ++i)
    if (fixed[i]) out.u[i] = values[i];
  std::vector<Real> r(n, 0);
  GlobalIndex const moved = std::count_if(out.u.begin(), out.u.end(), [](Real u) { return u != 0; });
  if (a.points().lattice().comm().sum(moved) > 0) a.apply(out.u.data(), r.data());
  for (std::size_t i = 0; i < n; ++i) r[i] = f[i] - r[i];
  free_part(r);
  out.report = conjugate_gradients(
      a.points().lattice().comm(),
      [&](std::vector<Real> const& p, std::vector<Real>& q) {
        a.apply(p.data(), q.data());
        free_part(q);
      },
      [&](std::vector<Real> const& residual, std::vector<Real>& z) {
        if (multigrid) return multigrid->apply(residual, z);
        for (std::size_t i = 0; i < n; ++i)
          z[i] = preconditioner == NodePreconditioner::jacobi ? residual[i] * inverse[i] : residual[i];
      },
      r, out.u, tolerance, most_iterations);
  return out;
}

}  // namespace amrpic
