#pragma once

#include "matrices/level_cells.hpp"

namespace amrpic {

/// An operator from the cells of a level to those of the same or another one: a Tpetra matrix, whose column map is all
/// cells that vectors of its level have places for. So operators that read the same vector share one exchange, and are
/// applied by `localApply`. Rows of an operator that acts on few of them (at coarse-fine faces) are listed, so that
/// applying it costs only those.
class SparseMatrix {
 public:
  SparseMatrix() = default;  ///< of nothing
  /// Collective over the ranks of the levels.
  SparseMatrix(TpetraTypes::LocalMatrix const& local, LevelCells const& rows, LevelCells const& columns);

  // ---- x: own cells and halo; y: own cells. Local. ----
  void multiply(LevelVector const& x, LevelVector& y) const;                        ///< y = A x
  void subtract(LevelVector const& f, LevelVector const& x, LevelVector& y) const;  ///< y = f - A x
  void add(Real scale, LevelVector const& x, LevelVector& y) const;                 ///< y += scale A x
  void set_rows(LevelVector const& x, LevelVector& y) const;  ///< y = A x in rows that have entries

  Teuchos::RCP<TpetraTypes::Matrix> const& matrix() const { return objects_->matrix; }
  std::size_t bytes() const;  ///< of this rank

 private:
  struct Objects {
    Teuchos::RCP<TpetraTypes::Matrix> matrix;
    DeviceArray<LocalIndex> occupied;  ///< rows with entries; none if all have
    bool is_full, is_sparse;           ///< whether all rows have entries; less than half of them
  };
  UntilFinalize<Objects> objects_;
};

}  // namespace amrpic
