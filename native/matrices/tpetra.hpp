#pragma once

#include <Teuchos_DefaultMpiComm.hpp>
#include <Tpetra_CrsMatrix.hpp>
#include <Tpetra_Import.hpp>
#include <Tpetra_Map.hpp>
#include <Tpetra_MultiVector.hpp>
#include <Tpetra_RowMatrix.hpp>
#include <algorithm>
#include <type_traits>
#include <vector>

#include "base/communicator.hpp"
#include "base/huge_pages.hpp"

namespace amrpic {

// All that names a Trilinos call which newer releases lack or rename stands in this file.

/// The Tpetra types that the library is instantiated for, and the memory and kernels of their node.
struct TpetraTypes {
  using Global = Tpetra::Map<>::global_ordinal_type;
  using Node = Tpetra::Map<>::node_type;
  using Map = Tpetra::Map<LocalIndex, Global, Node>;
  using Import = Tpetra::Import<LocalIndex, Global, Node>;
  using Matrix = Tpetra::CrsMatrix<Real, LocalIndex, Global, Node>;
  using RowMatrix = Tpetra::RowMatrix<Real, LocalIndex, Global, Node>;
  using MultiVector = Tpetra::MultiVector<Real, LocalIndex, Global, Node>;
  using Operator = Tpetra::Operator<Real, LocalIndex, Global, Node>;

  using LocalMatrix = Matrix::local_matrix_device_type;
  using Graph = LocalMatrix::staticcrsgraph_type;
  using RowStarts = Graph::row_map_type::non_const_type;
  using Columns = Graph::entries_type::non_const_type;
  using MatrixValues = LocalMatrix::values_type::non_const_type;

  using Device = Node::device_type;
  using Space = Node::execution_space;
  using Rows = Kokkos::RangePolicy<Space>;  ///< of kernels, one call per row
};

/// An array in the memory of Tpetra's node.
template <class T>
using DeviceArray = Kokkos::View<T*, Kokkos::LayoutLeft, TpetraTypes::Device>;

/// A host's values as a view of the host.
template <class T, class Allocator>
auto host_view(std::vector<T, Allocator> const& values) {
  return Kokkos::View<T const*, Kokkos::LayoutLeft, Kokkos::HostSpace, Kokkos::MemoryUnmanaged>(values.data(),
                                                                                                values.size());
}

/// A copy of a host's values in the memory of Tpetra's node.
template <class T, class Allocator>
DeviceArray<T> on_device(std::vector<T, Allocator> const& values) {
  DeviceArray<T> out(Kokkos::view_alloc(Kokkos::WithoutInitializing, "values"), values.size());
  Kokkos::deep_copy(out, host_view(values));
  return out;
}

/// A host's values as the memory of Tpetra's node has them: a copy unless both share memory, else the values
/// themselves, which must outlive what is returned.
template <class T, class Allocator>
auto seen_by_device(std::vector<T, Allocator> const& values) {
  return Kokkos::create_mirror_view_and_copy(TpetraTypes::Device::memory_space(), host_view(values));
}

/// An array of unset values in the memory of Tpetra's node.
template <class View, class... Extents>
View unset_array(Extents... extents) {
  View const out(Kokkos::view_alloc(Kokkos::WithoutInitializing, "values"), extents...);
  if constexpr (std::is_same_v<typename View::memory_space, Kokkos::HostSpace>)
    advise_huge_pages(out.data(), out.span() * sizeof(typename View::value_type));
  return out;
}

/// Elements of a map on this rank; Trilinos 14 renamed the call.
template <class Map>
auto local_size(Map const& map) -> decltype(map.getLocalNumElements()) {
  return map.getLocalNumElements();
}
template <class Map>
auto local_size(Map const& map) -> decltype(map.getNodeNumElements()) {
  return map.getNodeNumElements();
}

/// Parameters of a Tpetra matrix with unsorted columns in its rows.
inline Teuchos::RCP<Teuchos::ParameterList> unsorted_rows() {
  auto const out = Teuchos::rcp(new Teuchos::ParameterList);
  out->set("sorted", false);
  return out;
}

/// The ranks as Teuchos knows them.
inline Teuchos::RCP<Teuchos::Comm<int> const> ranks_of(Communicator const& comm) {
  return Teuchos::rcp(new Teuchos::MpiComm<int>(comm.handle()));
}

/// The one column of a vector, in the memory of Tpetra's node.
inline DeviceArray<Real> column_of(TpetraTypes::MultiVector& vector) {
  return Kokkos::subview(vector.getLocalViewDevice(Tpetra::Access::ReadWrite), Kokkos::ALL(), 0);
}
inline DeviceArray<Real const> column_of(TpetraTypes::MultiVector const& vector) {
  return Kokkos::subview(vector.getLocalViewDevice(Tpetra::Access::ReadOnly), Kokkos::ALL(), 0);
}

/// Copy values into a vector's local part, and out of it; further values are left alone.
template <class Values>
void copy_in(Values const& values, TpetraTypes::MultiVector& vector) {
  auto const view = vector.getLocalViewHost(Tpetra::Access::OverwriteAll);
  for (std::size_t i = 0; i < view.extent(0); ++i) view(i, 0) = values[i];
}
template <class Values>
void copy_out(TpetraTypes::MultiVector const& vector, Values& values) {
  auto const view = vector.getLocalViewHost(Tpetra::Access::ReadOnly);
  for (std::size_t i = 0; i < view.extent(0); ++i) values[i] = view(i, 0);
}

/// Rows of a sparse matrix on the host.
struct HostRows {
  std::vector<std::size_t> row_start{0};  ///< rows + 1 values
  std::vector<LocalIndex> column;
  std::vector<Real> value;

  LocalIndex rows() const { return LocalIndex(row_start.size()) - 1; }
};

/// A matrix of rows on the host, with a copy of their arrays. Collective over the maps' communicator.
inline Teuchos::RCP<TpetraTypes::Matrix> tpetra_matrix(HostRows const& host,
                                                       Teuchos::RCP<TpetraTypes::Map const> const& rows,
                                                       Teuchos::RCP<TpetraTypes::Map const> const& columns) {
  using T = TpetraTypes;
  T::RowStarts const row_start("row starts", host.row_start.size());
  T::Columns const column("columns", host.column.size());
  T::MatrixValues const value("values", host.value.size());
  auto const fill = [](auto const& view, auto const& values) {
    auto const mirror = Kokkos::create_mirror_view(view);
    std::copy(values.begin(), values.end(), mirror.data());
    Kokkos::deep_copy(view, mirror);
  };
  fill(row_start, host.row_start), fill(column, host.column), fill(value, host.value);
  T::LocalMatrix const local("matrix", host.rows(), LocalIndex(local_size(*columns)), host.value.size(), value,
                             row_start, column);
  return Teuchos::rcp(new T::Matrix(local, rows, columns, rows, rows));
}

/// This rank's rows of a matrix; columns are local to its column map.
inline HostRows host_rows(TpetraTypes::Matrix const& matrix) {
  auto const local = matrix.getLocalMatrixHost();
  auto const copied = [](auto const& view) {
    using Value = typename std::decay_t<decltype(view)>::non_const_value_type;
    return std::vector<Value>(view.data(), view.data() + view.extent(0));
  };
  auto const starts = copied(local.graph.row_map);
  return {{starts.begin(), starts.end()}, copied(local.graph.entries), copied(local.values)};
}

}  // namespace amrpic
