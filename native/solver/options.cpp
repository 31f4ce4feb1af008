#include "solver/options.hpp"

#include <Teuchos_Array.hpp>
#include <Teuchos_ParameterList.hpp>
#include <limits>

namespace amrpic {

using Teuchos::ParameterList;

std::string ifpack2_name(SmootherKind kind) { return kind == SmootherKind::chebyshev ? "CHEBYSHEV" : "RELAXATION"; }

ParameterList ifpack2_parameters(SolverOptions const& options, int sweeps, bool from_zero, Real oscillating) {
  ParameterList list;
  if (options.smoother == SmootherKind::chebyshev) {
    // By Gershgorin's circles no eigenvalue of the 7-point rows over their diagonal lies beyond 2, at walls and
    // coarse-fine faces neither; the library's own estimate by power iteration presumes symmetry.
    list.set("chebyshev: degree", sweeps);
    list.set("chebyshev: max eigenvalue", 2.0);
    list.set("chebyshev: boost factor", 1.0);
    list.set("chebyshev: ratio eigenvalue", 2.0 / oscillating);
    list.set("chebyshev: zero starting solution", from_zero);
    list.set("chebyshev: min diagonal value", std::numeric_limits<Real>::min());  // entries may be small in their units
    return list;
  }
  list.set("relaxation: type", options.smoother == SmootherKind::jacobi         ? "Jacobi"
                               : options.smoother == SmootherKind::gauss_seidel ? "Gauss-Seidel"
                                                                                : "Symmetric Gauss-Seidel");
  list.set("relaxation: sweeps", sweeps);
  list.set("relaxation: damping factor", options.relaxation);
  list.set("relaxation: zero starting solution", from_zero);
  return list;
}

std::string ifpack2_name(BottomPreconditioner kind) {
  return kind == BottomPreconditioner::ilu ? "RILUK" : "RELAXATION";
}

ParameterList ifpack2_parameters(BottomPreconditioner kind) {
  ParameterList list;
  if (kind == BottomPreconditioner::ilu) {
    list.set("fact: iluk level-of-fill", 0);
    return list;
  }
  list.set("relaxation: type", kind == BottomPreconditioner::jacobi ? "Jacobi" : "Symmetric Gauss-Seidel");
  list.set("relaxation: sweeps", 1);
  return list;
}

namespace {

/// MueLu's factories for aggregates along the lines of a mesh, which its plain list of parameters does not offer: each
/// factory by name, and their inputs.
ParameterList structured_aggregation(Index3 const& cells) {
  ParameterList list;
  auto factory = [&](char const* name, char const* kind) -> ParameterList& {
    return list.sublist("Factories").sublist(name).set("factory", kind);
  };
  factory("graph", "CoalesceDropFactory").set("lightweight wrap", true).set("aggregation: drop tol", 0.0);
  factory("aggregates", "StructuredAggregationFactory")
      .set("aggregation: mode", "uncoupled")
      .set("aggregation: output type", "Aggregates")
      .set("aggregation: coarsening order", 0)
      .set("aggregation: coarsening rate", "{2}")
      .set("Graph", "graph")
      .set("DofsPerNode", "graph");
  factory("coarse map", "CoarseMapFactory").set("Aggregates", "aggregates");
  factory("tentative", "TentativePFactory")
      .set("Aggregates", "aggregates")
      .set("CoarseMap", "coarse map")
      .set("tentative: build coarse coordinates", false);
  factory("prolongator", "SaPFactory").set("P", "tentative");
  factory("restrictor", "TransPFactory").set("P", "prolongator");
  factory("nullspace", "NullspaceFactory").set("Nullspace", "tentative");
  factory("mesh", "CoordinatesTransferFactory")
      .set("structured aggregation", true)
      .set("numDimensions", "aggregates")
      .set("lCoarseNodesPerDim", "aggregates");
  factory("matrix", "RAPFactory")
      .set("P", "prolongator")
      .set("R", "restrictor")
      .sublist("TransferFactories")
      .set("mesh", "mesh");
  factory("smoother", "TrilinosSmoother").set("type", "RELAXATION").sublist("ParameterList") =
      ifpack2_parameters(BottomPreconditioner::gauss_seidel);

  ParameterList& hierarchy = list.sublist("Hierarchy");
  hierarchy.set("verbosity", "none").set("max levels", 10).set("coarse: max size", 500);
  hierarchy.sublist("All")
      .set("Smoother", "smoother")
      .set("Nullspace", "nullspace")
      .set("Aggregates", "aggregates")
      .set("lCoarseNodesPerDim", "aggregates")
      .set("lNodesPerDim", "mesh")
      .set("numDimensions", "mesh")
      .set("P", "prolongator")
      .set("R", "restrictor")
      .set("A", "matrix");
  list.sublist("user data").set("int numDimensions", 3);
  list.sublist("user data").set("Array<LO> lNodesPerDim", Teuchos::Array<LocalIndex>(cells.begin(), cells.end()));
  return list;
}

}  // namespace

ParameterList muelu_parameters(BottomPreconditioner kind, Index3 const& cells) {
  if (kind == BottomPreconditioner::structured_aggregation) return structured_aggregation(cells);
  ParameterList list;
  list.set("verbosity", "none");
  list.set("coarse: max size", 500);
  if (kind == BottomPreconditioner::plain_aggregation) list.set("multigrid algorithm", "unsmoothed");
  if (kind == BottomPreconditioner::brick_aggregation) {
    list.set("aggregation: type", "brick");
    for (char const* size : {"aggregation: brick x size", "aggregation: brick y size", "aggregation: brick z size"})
      list.set(size, 2);
  }
  return list;
}

std::string belos_name(BottomKind kind) {
  switch (kind) {
    case BottomKind::cg:
      return "PSEUDOBLOCK CG";
    case BottomKind::bicgstab:
      return "BICGSTAB";
    case BottomKind::multigrid:
      return "FIXED POINT";
    default:
      return "BLOCK GMRES";
  }
}

ParameterList belos_parameters(BottomKind kind) {
  ParameterList list;
  list.set("Convergence Tolerance", 1e-8);  // far below what one cycle gains, so that the cycle does not notice
  list.set("Maximum Iterations", 200);
  if (kind == BottomKind::gmres) list.set("Num Blocks", 50);
  return list;
}

}  // namespace amrpic
