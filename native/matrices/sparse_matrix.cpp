#include "matrices/sparse_matrix.hpp"

namespace amrpic {

namespace {

using T = TpetraTypes;

DeviceArray<LocalIndex> occupied_rows(T::LocalMatrix const& local) {
  auto const start = local.graph.row_map;
  LocalIndex const rows = local.numRows();
  LocalIndex count = 0;
  Kokkos::parallel_reduce(
      "count occupied rows", T::Rows(0, rows),
      KOKKOS_LAMBDA(LocalIndex row, LocalIndex & sum) { sum += start(row + 1) > start(row); }, count);
  DeviceArray<LocalIndex> const out("occupied rows", count == rows ? 0 : std::size_t(count));
  if (count < rows)
    Kokkos::parallel_scan(
        "list occupied rows", T::Rows(0, rows), KOKKOS_LAMBDA(LocalIndex row, LocalIndex & place, bool last) {
          if (start(row + 1) == start(row)) return;
          if (last) out(place) = row;
          ++place;
        });
  return out;
}

/// y = beta y + alpha A x in some rows.
void multiply_rows(DeviceArray<LocalIndex> const& rows, T::LocalMatrix const& a, Real alpha,
                   DeviceArray<Real const> const& x, Real beta, DeviceArray<Real> const& y) {
  Kokkos::parallel_for(
      "multiply rows", T::Rows(0, LocalIndex(rows.extent(0))), KOKKOS_LAMBDA(LocalIndex n) {
        LocalIndex const row = rows(n);
        Real sum = 0;
        for (auto k = a.graph.row_map(row); k < a.graph.row_map(row + 1); ++k)
          sum += a.values(k) * x(a.graph.entries(k));
        y(row) = beta == 0 ? alpha * sum : beta * y(row) + alpha * sum;
      });
}

}  // namespace

SparseMatrix::SparseMatrix(T::LocalMatrix const& local, LevelCells const& rows, LevelCells const& columns) {
  // The diagonal comes first, then the neighbours, in the same order on any ranks.
  auto const matrix =
      Teuchos::rcp(new T::Matrix(local, rows.maps().own, columns.maps().all, columns.maps().own, rows.maps().own,
                                 columns.maps().to_all, Teuchos::null, unsorted_rows()));
  auto const occupied = occupied_rows(local);
  bool const full = occupied.extent(0) == 0 && local.nnz() > 0;
  objects_ =
      UntilFinalize<Objects>({matrix, occupied, full, !full && 2 * occupied.extent(0) <= std::size_t(local.numRows())});
}

void SparseMatrix::multiply(LevelVector const& x, LevelVector& y) const {
  matrix()->localApply(x.all(), y.own(), Teuchos::NO_TRANS, 1, 0);
}

void SparseMatrix::subtract(LevelVector const& f, LevelVector const& x, LevelVector& y) const {
  y.assign(f);
  add(-1, x, y);
}

void SparseMatrix::add(Real scale, LevelVector const& x, LevelVector& y) const {
  if (!objects_) return;
  if (objects_->is_sparse)
    multiply_rows(objects_->occupied, matrix()->getLocalMatrixDevice(), scale, x.values(), 1, y.values());
  else
    matrix()->localApply(x.all(), y.own(), Teuchos::NO_TRANS, scale, 1);
}

void SparseMatrix::set_rows(LevelVector const& x, LevelVector& y) const {
  if (objects_->is_full) return multiply(x, y);
  multiply_rows(objects_->occupied, matrix()->getLocalMatrixDevice(), 1, x.values(), 0, y.values());
}

std::size_t SparseMatrix::bytes() const {
  if (!objects_) return 0;
  auto const local = matrix()->getLocalMatrixDevice();
  return local.graph.row_map.extent(0) * sizeof(std::size_t) +
         local.values.extent(0) * (sizeof(LocalIndex) + sizeof(Real)) +
         objects_->occupied.extent(0) * sizeof(LocalIndex);
}

}  // namespace amrpic
