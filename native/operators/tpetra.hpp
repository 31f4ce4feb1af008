#pragma once

#include <Teuchos_DefaultMpiComm.hpp>
#include <Tpetra_CrsMatrix.hpp>
#include <Tpetra_Map.hpp>
#include <Tpetra_MultiVector.hpp>
#include <Tpetra_RowMatrix.hpp>
#include <algorithm>

#include "base/communicator.hpp"
#include "operators/operators.hpp"

namespace amrpic {

// All that names a Trilinos call which newer releases lack or rename stands in this file.

/// The Tpetra types that Debian's Trilinos is instantiated for.
struct TpetraTypes {
  using Global = Tpetra::Map<>::global_ordinal_type;
  using Node = Tpetra::Map<>::node_type;
  using Map = Tpetra::Map<LocalIndex, Global, Node>;
  using Matrix = Tpetra::CrsMatrix<Real, LocalIndex, Global, Node>;
  using RowMatrix = Tpetra::RowMatrix<Real, LocalIndex, Global, Node>;
  using MultiVector = Tpetra::MultiVector<Real, LocalIndex, Global, Node>;
  using Operator = Tpetra::Operator<Real, LocalIndex, Global, Node>;
};

/// Elements of a map on this rank; Trilinos 14 renamed the call.
template <class Map>
auto local_size(Map const& map) -> decltype(map.getNodeNumElements()) {
  return map.getNodeNumElements();
}

/// An operator as a Tpetra matrix with a copy of its arrays: Tpetra 13 takes no views of memory that Kokkos does not
/// own. Collective over the maps' communicator.
inline Teuchos::RCP<TpetraTypes::Matrix> tpetra_matrix(Crs const& crs, Teuchos::RCP<TpetraTypes::Map const> const& rows,
                                                       Teuchos::RCP<TpetraTypes::Map const> const& columns,
                                                       Teuchos::RCP<TpetraTypes::Map const> const& domain,
                                                       Teuchos::RCP<TpetraTypes::Map const> const& range) {
  using Local = TpetraTypes::Matrix::local_matrix_device_type;
  using Graph = Local::staticcrsgraph_type;
  typename Graph::row_map_type::non_const_type const row_start("row_start", crs.row_start.size());
  typename Graph::entries_type::non_const_type const column("column", crs.entries());
  typename Local::values_type::non_const_type const value("value", crs.entries());
  std::copy(crs.row_start.begin(), crs.row_start.end(), row_start.data());
  std::copy(crs.column.begin(), crs.column.end(), column.data());
  std::copy(crs.value.begin(), crs.value.end(), value.data());
  Local const local("operator", crs.rows(), LocalIndex(local_size(*columns)), crs.entries(), value, row_start, column);
  return Teuchos::rcp(new TpetraTypes::Matrix(local, rows, columns, domain, range));
}

/// The cells of a level as Tpetra numbers them: each rank its own run. Collective.
inline Teuchos::RCP<TpetraTypes::Map const> row_map(Communicator const& comm, LevelOperators const& operators) {
  auto const ranks = Teuchos::rcp(new Teuchos::MpiComm<int>(comm.handle()));
  return Teuchos::rcp(
      new TpetraTypes::Map(Tpetra::global_size_t(operators.level->cells()), std::size_t(operators.rows()), 0, ranks));
}

/// The cells of a level that this rank's operators read: its own, then the halo. Collective.
inline Teuchos::RCP<TpetraTypes::Map const> column_map(Communicator const& comm, LevelOperators const& operators) {
  std::vector<TpetraTypes::Global> cells;
  for (LocalIndex i = 0; i < operators.rows(); ++i) cells.push_back(operators.level->first_local_cell() + i);
  for (GlobalIndex cell : operators.halo.numbers()) cells.push_back(cell);
  auto const ranks = Teuchos::rcp(new Teuchos::MpiComm<int>(comm.handle()));
  auto const unknown = Teuchos::OrdinalTraits<Tpetra::global_size_t>::invalid();
  return Teuchos::rcp(new TpetraTypes::Map(unknown, Teuchos::ArrayView<TpetraTypes::Global const>(cells), 0, ranks));
}

/// An operator from the cells of one level to those of another (or the same) as a distributed Tpetra matrix.
/// Collective.
inline Teuchos::RCP<TpetraTypes::Matrix> tpetra_matrix(Communicator const& comm, Crs const& crs,
                                                       LevelOperators const& rows, LevelOperators const& columns) {
  auto const range = row_map(comm, rows);
  return tpetra_matrix(crs, range, column_map(comm, columns), row_map(comm, columns), range);
}

/// Copy values into a vector's local part, and out of it; further values are left alone.
inline void copy_in(std::vector<Real> const& values, TpetraTypes::MultiVector& vector) {
  auto const view = vector.getLocalViewHost(Tpetra::Access::OverwriteAll);
  for (std::size_t i = 0; i < view.extent(0); ++i) view(i, 0) = values[i];
}
inline void copy_out(TpetraTypes::MultiVector const& vector, std::vector<Real>& values) {
  auto const view = vector.getLocalViewHost(Tpetra::Access::ReadOnly);
  for (std::size_t i = 0; i < view.extent(0); ++i) values[i] = view(i, 0);
}

}  // namespace amrpic
