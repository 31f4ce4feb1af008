#include "solver/bottom.hpp"

#include <Ifpack2_Factory.hpp>
#include <cmath>
#include <numeric>

#include "base/communicator.hpp"
#include "base/error.hpp"
#include "base/runtime.hpp"
#include "solver/trilinos_solvers.hpp"

namespace amrpic {

namespace {

using MultiVector = TpetraTypes::MultiVector;
using Operator = TpetraTypes::Operator;
using Matrix = TpetraTypes::Matrix;

constexpr GlobalIndex most_cells = 1 << 22;            // each rank stores all of them
constexpr GlobalIndex most_cells_of_a_factor = 10000;  // KLU2 takes 11 s for 32^3, and grows with the square

/// For each cell of a level its place in the order of the domain, x fastest: the library's aggregation along mesh lines
/// asks for it.
std::vector<LocalIndex> order_of_domain(Level const& level) {
  std::vector<LocalIndex> out;
  out.reserve(std::size_t(level.cells()));
  for (Box const& box : level.boxes())
    for_each_cell(box, [&](Index3 const& cell) { out.push_back(LocalIndex(level.domain().offset(cell))); });
  return out;
}

/// The whole matrix of a level in the order of the domain, the same on all ranks; the diagonal comes first in each row.
HostRows gather(Communicator const& comm, LevelOperators const& operators, std::vector<LocalIndex> const& place) {
  HostRows const local = host_rows(*operators.no_fine.matrix());
  auto const numbers = operators.cells->numbers();
  std::vector<LocalIndex> columns, lengths;
  for (LocalIndex c : local.column) columns.push_back(LocalIndex(numbers[std::size_t(c)]));
  for (LocalIndex r = 0; r < local.rows(); ++r)
    lengths.push_back(LocalIndex(local.row_start[r + 1] - local.row_start[r]));
  auto const column = comm.gather(columns).values;
  auto const value = comm.gather(local.value).values;
  auto const length = comm.gather(lengths).values;

  std::vector<std::size_t> start(place.size());  // of each row of the domain's order, in the gathered arrays
  HostRows whole;
  whole.row_start.resize(place.size() + 1, 0);
  std::size_t at = 0;
  for (std::size_t cell = 0; cell < place.size(); ++cell) {
    start[std::size_t(place[cell])] = at;
    whole.row_start[std::size_t(place[cell]) + 1] = std::size_t(length[cell]);
    at += std::size_t(length[cell]);
  }
  std::partial_sum(whole.row_start.begin(), whole.row_start.end(), whole.row_start.begin());
  for (std::size_t row = 0; row < place.size(); ++row)
    for (std::size_t k = 0; k < whole.row_start[row + 1] - whole.row_start[row]; ++k) {
      whole.column.push_back(place[std::size_t(column[start[row] + k])]);
      whole.value.push_back(value[start[row] + k]);
    }
  return whole;
}

/// Volumes of a level's cells in the order of the domain, over that of ordinary ones.
std::vector<Real> volumes_of(LevelOperators const& operators) {
  std::vector<Real> out;
  Box const& domain = operators.level->domain();
  out.reserve(std::size_t(domain.cells()));
  for_each_cell(domain, [&](Index3 const& cell) {
    Real volume = 1;
    for (int d = 0; d < 3; ++d)
      if (cell[d] == domain.upper[d]) volume *= operators.last_width[d];
    out.push_back(volume);
  });
  return out;
}

/// The matrix times the volumes of its cells, which makes it symmetric where the ghosts do not prevent it, and over its
/// first diagonal entry, which is negative as all are: positive definite, of order one in any units. A singular one
/// gets its first diagonal entry doubled: for a right-hand side without net charge this picks the solution that
/// vanishes there.
Real normalise(HostRows& matrix, std::vector<Real> const& volume, bool singular) {
  for (LocalIndex row = 0; row < matrix.rows(); ++row)
    for (std::size_t k = matrix.row_start[row]; k < matrix.row_start[row + 1]; ++k)
      matrix.value[k] *= volume[std::size_t(row)];
  Real const scale = 1 / matrix.value.front();
  for (Real& v : matrix.value) v *= scale;
  if (singular) matrix.value.front() *= 2;
  return scale;
}

bool symmetric(HostRows const& matrix) {
  auto const entry = [&](LocalIndex row, LocalIndex column) {
    Real sum = 0;
    for (std::size_t k = matrix.row_start[row]; k < matrix.row_start[row + 1]; ++k)
      if (matrix.column[k] == column) sum += matrix.value[k];
    return sum;
  };
  for (LocalIndex row = 0; row < matrix.rows(); ++row)
    for (std::size_t k = matrix.row_start[row]; k < matrix.row_start[row + 1]; ++k)
      if (std::abs(entry(row, matrix.column[k]) - entry(matrix.column[k], row)) > 1e-12) return false;
  return true;
}

/// The refusal of a matrix that the chosen method cannot solve; all ranks give the same one.
void require_fit(HostRows const& matrix, SolverOptions const& options) {
  std::string const cells = std::to_string(matrix.rows());
  if (options.bottom == BottomKind::cg && !symmetric(matrix))
    throw SolverError(
        "bottom is \"cg\", but the coarsest level's matrix is not symmetric, since Dirichlet ghosts are quadratic "
        "along "
        "axes that no multigrid level coarsens; use \"gmres\" or \"bicgstab\", or more coarse_levels");
  if (options.bottom == BottomKind::direct && matrix.rows() > most_cells_of_a_factor)
    throw SolverError("bottom is \"direct\", but the coarsest level has " + cells + " cells, more than the " +
                      std::to_string(most_cells_of_a_factor) +
                      " that KLU2 factors in reasonable time; use \"gmres\", or more coarse_levels");
}

}  // namespace

struct Bottom::GatheredProblem {
  LocalIndex rows;
  Real scale;
  Teuchos::RCP<Matrix> matrix;
  Teuchos::RCP<MultiVector> x, b;
  std::unique_ptr<BelosIterations> iterations;
  std::function<void()> solve_by_factors;
  AtFinalize release{[this] {
    solve_by_factors = nullptr, iterations = nullptr;
    x = Teuchos::null, b = Teuchos::null, matrix = Teuchos::null;
  }};

  GatheredProblem(HostRows const& whole, Real scale, Index3 const& cells, SolverOptions const& options)
      : rows(whole.rows()), scale(scale) {
    auto const self = Teuchos::rcp(new Teuchos::MpiComm<int>(MPI_COMM_SELF));
    auto const map = Teuchos::rcp(new TpetraTypes::Map(Tpetra::global_size_t(rows), 0, self));
    matrix = tpetra_matrix(whole, map, map);
    x = Teuchos::rcp(new MultiVector(map, 1));
    b = Teuchos::rcp(new MultiVector(map, 1));
    if (options.bottom == BottomKind::direct) {
      solve_by_factors = klu2_solve(matrix, x, b);
      return;
    }
    auto const side = options.bottom == BottomKind::cg ? BelosIterations::Side::left : BelosIterations::Side::right;
    iterations = std::make_unique<BelosIterations>(belos_name(options.bottom), matrix, x, b,
                                                   made(options.bottom_preconditioner, cells), side,
                                                   belos_parameters(options.bottom));
  }

  Teuchos::RCP<Operator> made(BottomPreconditioner kind, Index3 const& cells) const {
    if (kind == BottomPreconditioner::none) return Teuchos::null;
    if (aggregates(kind)) {
      auto parameters = muelu_parameters(kind, cells);
      if (kind == BottomPreconditioner::brick_aggregation)
        parameters.sublist("user data").set("Coordinates", coordinates(cells));
      return muelu_cycle(matrix, parameters);
    }
    auto out = Ifpack2::Factory::create<TpetraTypes::RowMatrix>(ifpack2_name(kind), matrix);
    out->setParameters(ifpack2_parameters(kind));
    out->initialize();
    out->compute();
    return out;
  }

  /// Cell indices: aggregates follow the mesh, whatever its spacing.
  Teuchos::RCP<MultiVector> coordinates(Index3 const& cells) const {
    auto const out = Teuchos::rcp(new MultiVector(matrix->getRowMap(), 3));
    auto const view = out->getLocalViewHost(Tpetra::Access::OverwriteAll);
    for (LocalIndex row = 0; row < rows; ++row) {
      view(row, 0) = row % cells[0];
      view(row, 1) = row / cells[0] % cells[1];
      view(row, 2) = row / cells[0] / cells[1];
    }
    return out;
  }

  bool has(HostRows const& other) const {
    HostRows const mine = host_rows(*matrix);
    return other.row_start == mine.row_start && other.column == mine.column && other.value == mine.value;
  }

  /// x for b.
  void solve() {
    x->putScalar(0);
    if (solve_by_factors) {
      solve_by_factors();
    } else {
      // Whatever it reached is a correction; the residual of the whole problem shows whether it was good enough.
      try {
        iterations->run();
      } catch (std::logic_error const&) {  // such as CG's, when it hits on the exact solution and finds nothing left
      }
    }
  }
};

namespace {

/// Put gathered values times the volumes of their cells in the order of the domain; returns the largest magnitude.
Real put_in_order(DeviceArray<LocalIndex> const& place, DeviceArray<Real> const& volume,
                  DeviceArray<Real> const& gathered, DeviceArray<Real> const& f) {
  Real largest = 0;
  Kokkos::parallel_reduce(
      "order of the domain", TpetraTypes::Rows(0, LocalIndex(place.extent(0))),
      KOKKOS_LAMBDA(LocalIndex cell, Real & most) {
        LocalIndex const row = place(cell);
        f(row) = volume(row) * gathered(cell);
        Real const size = f(row) < 0 ? -f(row) : f(row);
        if (size > most) most = size;
      },
      Kokkos::Max<Real>(largest));
  return largest;
}

Real mean_of(DeviceArray<Real> const& values) {
  Real sum = 0;
  Kokkos::parallel_reduce(
      "mean", TpetraTypes::Rows(0, LocalIndex(values.extent(0))),
      KOKKOS_LAMBDA(LocalIndex n, Real & part) { part += values(n); }, sum);
  return sum / Real(values.extent(0));
}

/// values = (values - less) / over.
void shift_and_divide(DeviceArray<Real> const& values, Real less, Real over) {
  Kokkos::parallel_for(
      "shift and divide", TpetraTypes::Rows(0, LocalIndex(values.extent(0))),
      KOKKOS_LAMBDA(LocalIndex n) { values(n) = (values(n) - less) / over; });
}

/// own = factor (whole - less), for the cells from number `first` on.
void take_own(DeviceArray<LocalIndex> const& place, LocalIndex first, DeviceArray<Real> const& whole, Real less,
              Real factor, DeviceArray<Real> const& own) {
  Kokkos::parallel_for(
      "own cells", TpetraTypes::Rows(0, LocalIndex(own.extent(0))),
      KOKKOS_LAMBDA(LocalIndex row) { own(row) = (whole(place(first + row)) - less) * factor; });
}

}  // namespace

Bottom::Bottom(Communicator const& comm, LevelOperators const& operators, Mean mean, SolverOptions const& options)
    : comm_(comm), mean_(mean), first_(operators.level->first_local_cell()), total_(operators.level->cells()) {
  if (total_ > most_cells)
    throw SolverError("the coarsest level would have " + std::to_string(total_) +
                      " cells; give the base numbers of cells with more factors of two, or more coarse_levels");
  int const ranks = operators.level->ranks();
  for (int r = 0; r < ranks; ++r) {
    starts_.push_back(int(operators.level->first_cell(r)));
    counts_.push_back(int(operators.level->first_cell(r + 1) - operators.level->first_cell(r)));
  }
  place_ = order_of_domain(*operators.level);
  HostRows whole = gather(comm, operators, place_);
  auto const volume = volumes_of(operators);
  on_device_ = UntilFinalize<OnDevice>(
      {on_device(place_), on_device(volume), DeviceArray<Real>("gathered", std::size_t(total_))});
  Real const scale = normalise(whole, volume, mean == Mean::nothing);
  require_fit(whole, options);
  Box const& domain = operators.level->domain();
  problem_ = std::make_unique<GatheredProblem>(whole, scale,
                                               Index3{domain.extent(0), domain.extent(1), domain.extent(2)}, options);
}

Bottom::~Bottom() = default;

bool Bottom::serves(LevelOperators const& operators) const {
  for (int r = 0; r < int(counts_.size()); ++r)
    if (operators.level->first_cell(r) != starts_[r]) return false;
  if (operators.level->cells() != total_ || order_of_domain(*operators.level) != place_) return false;
  HostRows whole = gather(comm_, operators, place_);
  Real const scale = normalise(whole, volumes_of(operators), mean_ == Mean::nothing);
  return scale == problem_->scale && problem_->has(whole);
}

/// MPI takes host memory, which the device's is where both are one.
void Bottom::gather_right_hand_side(LevelVector const& right_hand_side) const {
  auto const all = Kokkos::create_mirror_view(on_device_->gathered);
  auto const own = right_hand_side.own().getLocalViewHost(Tpetra::Access::ReadOnly);
  comm_.gather_into(own.data(), counts_, starts_, all.data());
  Kokkos::deep_copy(on_device_->gathered, all);
}

void Bottom::solve(LevelVector const& right_hand_side, LevelVector& correction) {
  gather_right_hand_side(right_hand_side);
  auto const& [place, volume, gathered] = *on_device_;
  Real size = 0;
  {
    auto const f = column_of(*problem_->b);
    size = put_in_order(place, volume, gathered, f);
    if (size == 0) return correction.set_zero();
    shift_and_divide(f, 0, size);  // of order one, so that no library threshold meets the units
    if (mean_ != Mean::equation) shift_and_divide(f, mean_of(f), 1);
  }
  problem_->solve();
  auto const x = column_of(*problem_->x);
  take_own(place, LocalIndex(first_), x, mean_ == Mean::equation ? 0.0 : mean_of(x), size * problem_->scale,
           column_of(correction.own()));
}

}  // namespace amrpic
