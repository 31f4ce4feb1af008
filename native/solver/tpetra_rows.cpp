#include "solver/tpetra_rows.hpp"

#include <algorithm>
#include <utility>

namespace amrpic {

using Global = TpetraTypes::Global;
using Map = Teuchos::RCP<TpetraTypes::Map const>;

namespace {

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

}  // namespace

Teuchos::RCP<TpetraTypes::Matrix> tpetra_matrix(SharedRows const& rows, Map const& own) {
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

}  // namespace amrpic
