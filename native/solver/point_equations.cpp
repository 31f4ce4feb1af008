#include "solver/point_equations.hpp"

#include <algorithm>

#include "solver/options.hpp"
#include "solver/tpetra_rows.hpp"
#include "solver/trilinos_solvers.hpp"

namespace amrpic {

namespace {

using Map = Teuchos::RCP<TpetraTypes::Map const>;
using MultiVector = TpetraTypes::MultiVector;

constexpr int restart = 60;  // vectors that GMRES keeps

Teuchos::ParameterList aggregation() {
  Teuchos::ParameterList list, sweeps;
  list.set("verbosity", "none");
  list.set("multigrid algorithm", "unsmoothed");
  list.set("cycle type", "W");
  list.set("coarse: max size", 100);
  sweeps.set("relaxation: type", "Symmetric Gauss-Seidel");
  list.set("smoother: type", "RELAXATION");
  list.set("smoother: params", sweeps);
  sweeps.set("relaxation: sweeps", 20);
  list.set("coarse: type", "RELAXATION");
  list.set("coarse: params", sweeps);
  return list;
}

/// |b - A x| / |b|, or |A x| for b = 0.
Real relative_residual(TpetraTypes::Matrix const& matrix, MultiVector const& x, MultiVector const& b) {
  MultiVector r(b, Teuchos::Copy);
  matrix.apply(x, r, Teuchos::NO_TRANS, -1, 1);
  Real const size = b.getVector(0)->norm2(), left = r.getVector(0)->norm2();
  return size > 0 ? left / size : left;
}

}  // namespace

PointSolution solve_points(Communicator const& comm, SharedRows const& rows, std::vector<Real> const& right_hand_sides,
                           std::size_t vectors, Real tolerance, int most_iterations) {
  auto const ranks = Teuchos::rcp(new Teuchos::MpiComm<int>(comm.handle()));
  auto const unknown = Teuchos::OrdinalTraits<Tpetra::global_size_t>::invalid();
  std::size_t const count = std::size_t(rows.rows());
  Map const own = Teuchos::rcp(new TpetraTypes::Map(unknown, count, 0, ranks));
  auto const matrix = tpetra_matrix(rows, own);
  auto const x = Teuchos::rcp(new MultiVector(own, 1)), b = Teuchos::rcp(new MultiVector(own, 1));
  Teuchos::ParameterList list;
  list.set("Convergence Tolerance", tolerance);
  list.set("Maximum Iterations", most_iterations);
  list.set("Num Blocks", restart);
  list.set("Implicit Residual Scaling", "Norm of RHS");
  list.set("Explicit Residual Scaling", "Norm of RHS");
  BelosIterations gmres(belos_name(BottomKind::gmres), matrix, x, b, muelu_cycle(matrix, aggregation()),
                        BelosIterations::Side::right, list);

  // One after the other: two at a time stop by residuals that the true ones have left behind.
  PointSolution out{{}, 0, 0};
  std::vector<Real> given, found(count);
  for (std::size_t v = 0; v < vectors; ++v) {
    given.assign(right_hand_sides.begin() + v * count, right_hand_sides.begin() + (v + 1) * count);
    copy_in(given, *b);
    x->putScalar(0);
    out.iterations = std::max(out.iterations, gmres.run());
    out.residual = std::max(out.residual, relative_residual(*matrix, *x, *b));
    copy_out(*x, found);
    out.x.insert(out.x.end(), found.begin(), found.end());
  }
  return out;
}

}  // namespace amrpic
