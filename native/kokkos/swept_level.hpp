#pragma once

#include <array>

#include "kokkos/cell_copies.hpp"
#include "matrixfree/row_kernels.hpp"
#include "matrixfree/swept_level.hpp"
#include "stencil/laplacian.hpp"

namespace amrpic::kokkos {

/// A row of cells of a level, and where its neighbours are: a RowStencil with all that it leaves to the block.
struct Row {
  std::int32_t place;
  std::array<std::int32_t, 4> beside;  ///< as in RowStencil; ~(place among composed values)
  std::array<std::int32_t, 2> end;
  std::array<float, 2> factor;
  std::int32_t coefficients, pitch;
  std::int32_t cells;
  std::int8_t lanes;   ///< cells in a vector of the host
  std::int8_t parity;  ///< of the places of colour 0
  std::int8_t steps;   ///< from own cells
};

/// Which row of which own block a row is.
struct RowPlace {
  std::int32_t block;
  std::int32_t j, k;  ///< counted from the block's first
};

/// What kernels read of a level besides its values.
struct LevelTables {
  Array<Row> rows;                           ///< of own blocks first
  Array<matrixfree::ScaledRun> composition;  ///< of rows beside rows that are none in memory
  Array<float> composed;                     ///< what it gives, row after row, each of whole vectors
  Array<float> coefficients;
  std::array<float, 3> weight;
  bool isotropic;
  float keep;
  bool in_differences;  ///< are residuals, and for them composed rows
  std::int32_t zero_row;

  /// A row's correction and its neighbours'.
  KOKKOS_INLINE_FUNCTION matrixfree::CorrectionRow correction(Row const& row, float* e) const {
    matrixfree::CorrectionRow out;
    out.here = e + row.place;
    for (std::size_t side = 0; side < 4; ++side)
      out.beside[side] = row.beside[side] >= 0 ? e + row.beside[side] : composed.data() + ~row.beside[side];
    out.left = row.factor[0] * e[row.end[0]];
    out.right = row.factor[1] * e[row.end[1]];
    out.vectors = row.pitch / row.lanes;
    out.last = (row.cells - 1) % row.lanes;
    return out;
  }
  /// The same for a residual of differences.
  KOKKOS_INLINE_FUNCTION matrixfree::DifferenceRow differences(Row const& row, float* e) const {
    matrixfree::DifferenceRow out{correction(row, e), {}, row.cells};
    for (std::size_t side = 0; side < 4; ++side)
      out.less[side] = row.beside[side] < 0 || row.beside[side] == zero_row ? e + zero_row : out.here;
    out.left = row.factor[0] * (e[row.end[0]] - out.here[0]);
    out.right = row.factor[1] * (e[row.end[1]] - out.here[row.cells - 1]);
    return out;
  }
  /// The weighted sum over the neighbours of a cell.
  KOKKOS_INLINE_FUNCTION float sum(Row const& row, matrixfree::CorrectionRow const& at, int i) const {
    float const before = i > 0 ? at.here[i - 1] : at.left, after = i + 1 < row.cells ? at.here[i + 1] : at.right;
    return weighted_sum(weight, before + after, at.beside[0][i] + at.beside[1][i], at.beside[2][i] + at.beside[3][i]);
  }
};

/// A level of the cycle in the kernels' memory: the sweeps of a matrixfree::SweptLevel, each half of one kernel over
/// all rows. The two share what they are made of, and on the host the values.
class SweptLevel {
 public:
  /// `plan` must outlive this. Collective.
  SweptLevel(Communicator const& comm, matrixfree::SweptLevel& plan);

  /// See matrixfree::SweptLevel. All are collective.
  void relax(int sweeps, bool from_zero, int further);
  void exchange_right_hand_sides();
  void exchange_corrections(bool boundary_changed);
  void finish() {}
  void corrections_are_new() { stale_ = matrixfree::both_colours; }
  /// Bring what a residual in own cells reads.
  void prepare_residual();

  LevelTables const& tables() const { return tables_; }
  Array<RowPlace> const& own_rows() const { return own_rows_; }
  std::vector<std::int32_t> const& first_rows() const { return first_rows_; }  ///< of the blocks
  Mirrored<float> const& right_hand_side() const { return r_; }
  Mirrored<float> const& correction() const { return e_; }
  matrixfree::SweptLevel& plan() const { return plan_; }

  std::size_t bytes() const;

  // Parts of `relax`, public because CUDA wants members with kernels to be.
  void compose(Part const& runs, bool differences);
  template <bool from_zero>
  void half_sweep(Part const& rows, int colour, int reach);

 private:
  void bring(int colours);

  matrixfree::SweptLevel& plan_;
  LevelTables tables_;
  Array<RowPlace> own_rows_;
  std::vector<std::int32_t> first_rows_;
  struct Together {
    Part rows, composition;
  };
  std::vector<Together> together_;  ///< rows that may be relaxed at once, and what composes those beside them
  Mirrored<float> r_, e_;
  CellCopies halo_, edge_halo_;
  std::array<CellCopies, 2> halo_of_colour_;
  int stale_ = matrixfree::both_colours;
};

}  // namespace amrpic::kokkos
