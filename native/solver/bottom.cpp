#include "solver/bottom.hpp"

#include <BelosBlockGmresSolMgr.hpp>
#include <BelosTpetraAdapter.hpp>
#include <MueLu_CreateTpetraPreconditioner.hpp>
#include <Tpetra_CrsMatrix.hpp>
#include <algorithm>
#include <numeric>

#include "base/all_gather.hpp"
#include "base/error.hpp"
#include "base/runtime.hpp"
#include "operators/tpetra.hpp"

namespace amrpic {

namespace {

using MultiVector = TpetraTypes::MultiVector;
using Operator = TpetraTypes::Operator;

/// The whole matrix of a level, columns in global numbers, alike on all ranks.
Crs gather(MPI_Comm comm, LevelOperators const& operators) {
  Crs const& local = operators.no_fine;
  GlobalIndex const first = operators.level->first_local_cell();
  auto const& ghosts = operators.halo.ghost_numbers();
  std::vector<LocalIndex> columns, lengths;
  for (LocalIndex c : local.column)
    columns.push_back(LocalIndex(c < local.rows() ? first + c : ghosts[std::size_t(c - local.rows())]));
  for (LocalIndex r = 0; r < local.rows(); ++r)
    lengths.push_back(LocalIndex(local.row_start[r + 1] - local.row_start[r]));

  Crs whole;
  whole.column = all_gather(comm, columns).values;
  whole.value = all_gather(comm, local.value).values;
  for (LocalIndex n : all_gather(comm, lengths).values)
    whole.row_start.push_back(whole.row_start.back() + std::size_t(n));
  return whole;
}

/// Minus the matrix over its first diagonal entry: positive definite, of order one in any units. A singular one gets
/// its first diagonal entry doubled: for a right-hand side without mean this picks the solution that vanishes there.
Real normalise(Crs& matrix, bool singular) {
  Real const scale = -1 / matrix.value.front();
  for (Real& v : matrix.value) v *= scale;
  if (singular) matrix.value.front() *= 2;
  return scale;
}

}  // namespace

struct Bottom::Problem {
  using Linear = Belos::LinearProblem<Real, MultiVector, Operator>;

  LocalIndex rows;
  Real scale;
  Teuchos::RCP<TpetraTypes::Matrix> matrix;
  Teuchos::RCP<MultiVector> x, b;
  Teuchos::RCP<Linear> linear;
  Teuchos::RCP<Belos::SolverManager<Real, MultiVector, Operator>> gmres;
  AtFinalize release{[this] {
    gmres = Teuchos::null, linear = Teuchos::null, x = Teuchos::null, b = Teuchos::null, matrix = Teuchos::null;
  }};

  Problem(Crs whole, bool singular) : rows(whole.rows()), scale(normalise(whole, singular)) {
    auto const self = Teuchos::rcp(new Teuchos::MpiComm<int>(MPI_COMM_SELF));
    auto const map = Teuchos::rcp(new TpetraTypes::Map(Tpetra::global_size_t(rows), 0, self));
    matrix = tpetra_matrix(whole, map, map, map, map);
    x = Teuchos::rcp(new MultiVector(map, 1));
    b = Teuchos::rcp(new MultiVector(map, 1));

    Teuchos::ParameterList amg;
    amg.set("verbosity", "none");
    amg.set("coarse: max size", 500);
    auto const as_operator = Teuchos::rcp_implicit_cast<Operator>(matrix);
    linear = Teuchos::rcp(new Linear(as_operator, x, b));
    linear->setRightPrec(
        MueLu::CreateTpetraPreconditioner<Real, LocalIndex, TpetraTypes::Global, TpetraTypes::Node>(as_operator, amg));

    auto krylov = Teuchos::rcp(new Teuchos::ParameterList);
    krylov->set("Convergence Tolerance", 1e-8);  // far below what one cycle gains, so that the cycle does not notice
    krylov->set("Maximum Iterations", 200);
    krylov->set("Num Blocks", 50);
    krylov->set("Verbosity", int(Belos::Errors));
    gmres = Teuchos::rcp(new Belos::BlockGmresSolMgr<Real, MultiVector, Operator>(linear, krylov));
  }

  void solve(std::vector<Real> const& right_hand_side, std::vector<Real>& solution) {
    copy_in(right_hand_side, *b);
    x->putScalar(0);
    linear->setProblem();
    // Whatever it reached is a correction; the residual of the whole problem tells whether it was good enough.
    gmres->solve();
    copy_out(*x, solution);
  }
};

Bottom::Bottom(MPI_Comm comm, LevelOperators const& operators, bool singular)
    : comm_(comm),
      singular_(singular),
      rows_(operators.rows()),
      first_(operators.level->first_local_cell()),
      total_(operators.level->cells()) {
  if (total_ > 1 << 22)  // each rank holds all of it
    throw SolverError("the coarsest level would have " + std::to_string(total_) +
                      " cells; give the base numbers of cells with more factors of two");
  int const ranks = operators.level->ranks();
  for (int r = 0; r < ranks; ++r) {
    starts_.push_back(int(operators.level->first_cell(r)));
    counts_.push_back(int(operators.level->first_cell(r + 1) - operators.level->first_cell(r)));
  }
  whole_right_hand_side_.resize(std::size_t(total_));
  whole_correction_.resize(std::size_t(total_));
  problem_ = std::make_unique<Problem>(gather(comm, operators), singular);
}

Bottom::~Bottom() = default;

void Bottom::solve(std::vector<Real> const& right_hand_side, std::vector<Real>& correction) {
  auto& f = whole_right_hand_side_;
  MPI_Allgatherv(right_hand_side.data(), rows_, MPI_DOUBLE, f.data(), counts_.data(), starts_.data(), MPI_DOUBLE,
                 comm_);
  Real const size = *std::max_element(f.begin(), f.end(), [](Real a, Real b) { return std::abs(a) < std::abs(b); });
  if (size == 0) {
    std::fill(correction.begin(), correction.end(), 0.0);
    return;
  }
  // of order one, so that no library threshold meets the units
  for (Real& v : f) v /= size;
  if (singular_) {
    Real const mean = std::accumulate(f.begin(), f.end(), 0.0) / Real(total_);
    for (Real& v : f) v -= mean;
  }
  problem_->solve(f, whole_correction_);
  Real const mean =
      singular_ ? std::accumulate(whole_correction_.begin(), whole_correction_.end(), 0.0) / Real(total_) : 0.0;
  for (LocalIndex row = 0; row < rows_; ++row)
    correction[row] = (whole_correction_[std::size_t(first_ + row)] - mean) * size * problem_->scale;
}

}  // namespace amrpic
