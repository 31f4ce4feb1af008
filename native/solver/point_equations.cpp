#include "solver/point_equations.hpp"

#include <BelosBlockGmresSolMgr.hpp>
#include <BelosTpetraAdapter.hpp>
#include <MueLu_CreateTpetraPreconditioner.hpp>
#include <algorithm>
#include <utility>

#include "operators/tpetra.hpp"

namespace amrpic {

namespace {

using Global = TpetraTypes::Global;
using Map = Teuchos::RCP<TpetraTypes::Map const>;
using MultiVector = TpetraTypes::MultiVector;
using Operator = TpetraTypes::Operator;

constexpr int restart = 60;  // vectors that GMRES keeps

/// The rows' own numbers, then those of other ranks that they name.
std::vector<Global> columns_of(SharedRows const& rows, Map const& own) {
  std::vector<Global> out, foreign;
  for (LocalIndex r = 0; r < rows.rows(); ++r) out.push_back(own->getGlobalElement(r));
  for (GlobalIndex c : rows.column)
    if (!own->isNodeGlobalElement(c)) foreign.push_back(c);
  std::sort(foreign.begin(), foreign.end());
  foreign.erase(std::unique(foreign.begin(), foreign.end()), foreign.end());
  out.insert(out.end(), foreign.begin(), foreign.end());
  return out;
}

/// Tpetra's form of the rows.
Teuchos::RCP<TpetraTypes::Matrix> matrix_of(SharedRows const& rows, Map const& own) {
  auto const unknown = Teuchos::OrdinalTraits<Tpetra::global_size_t>::invalid();
  auto const numbers = columns_of(rows, own);
  Map const columns =
      Teuchos::rcp(new TpetraTypes::Map(unknown, Teuchos::ArrayView<Global const>(numbers), 0, own->getComm()));
  HostRows local;
  local.row_start.assign(rows.row_start.begin(), rows.row_start.end());
  std::vector<std::pair<LocalIndex, Real>> row;
  for (LocalIndex r = 0; r < rows.rows(); ++r) {
    row.clear();
    for (std::size_t k = rows.row_start[r]; k < rows.row_start[r + 1]; ++k)
      row.push_back({columns->getLocalElement(rows.column[k]), rows.value[k]});
    std::sort(row.begin(), row.end());  // Tpetra presumes it: in another order the solve fails, without a word
    for (auto const& [column, value] : row) local.column.push_back(column), local.value.push_back(value);
  }
  return tpetra_matrix(local, own, columns);
}

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
  auto const matrix = matrix_of(rows, own);
  auto const x = Teuchos::rcp(new MultiVector(own, 1)), b = Teuchos::rcp(new MultiVector(own, 1));
  Teuchos::ParameterList aggregates = aggregation();
  auto const linear = Teuchos::rcp(new Belos::LinearProblem<Real, MultiVector, Operator>(matrix, x, b));
  linear->setRightPrec(MueLu::CreateTpetraPreconditioner<Real, LocalIndex, Global, TpetraTypes::Node>(
      Teuchos::rcp_implicit_cast<Operator>(matrix), aggregates));
  auto const list = Teuchos::rcp(new Teuchos::ParameterList);
  list->set("Convergence Tolerance", tolerance);
  list->set("Maximum Iterations", most_iterations);
  list->set("Num Blocks", restart);
  list->set("Verbosity", int(Belos::Errors));
  list->set("Implicit Residual Scaling", "Norm of RHS");
  list->set("Explicit Residual Scaling", "Norm of RHS");
  Belos::BlockGmresSolMgr<Real, MultiVector, Operator> gmres(linear, list);

  // One after the other: two at a time stop by residuals that the true ones have left behind.
  PointSolution out{{}, 0, 0};
  std::vector<Real> given, found(count);
  for (std::size_t v = 0; v < vectors; ++v) {
    given.assign(right_hand_sides.begin() + v * count, right_hand_sides.begin() + (v + 1) * count);
    copy_in(given, *b);
    x->putScalar(0);
    linear->setProblem();
    gmres.solve();
    out.iterations = std::max(out.iterations, gmres.getNumIters());
    out.residual = std::max(out.residual, relative_residual(*matrix, *x, *b));
    copy_out(*x, found);
    out.x.insert(out.x.end(), found.begin(), found.end());
  }
  return out;
}

}  // namespace amrpic
