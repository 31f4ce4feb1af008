#pragma once

#include <array>

#include "kokkos/cell_copies.hpp"
#include "matrixfree/swept_level.hpp"
#include "stencil/laplacian.hpp"

namespace amrpic::kokkos {

/// A row of cells of a level, and where its neighbours are: a RowStencil with all that it leaves to the block.
struct Row {
  std::int32_t place;
  std::array<std::int32_t, 4> beside;  ///< as in RowStencil; ~(place among composed cells)
  std::array<std::int32_t, 2> end;
  std::array<float, 2> factor;
  std::int32_t coefficients, pitch;
  std::int32_t cells;
  std::int8_t parity;  ///< of the places of colour 0
  std::int8_t steps;   ///< from own cells
  bool is_composed;    ///< whether a row beside it is
};

/// Which row of which own block a row is.
struct RowPlace {
  std::int32_t block;
  std::int32_t j, k;  ///< counted from the block's first
};

/// A cell of a row that lies beside another one and is none in memory: factor * e[source].
struct ComposedCell {
  std::int32_t source;
  float factor;
};

/// What kernels read of a level besides its values.
struct LevelTables {
  Array<Row> rows;  ///< of own blocks first
  Array<ComposedCell> composed;
  Array<float> coefficients;
  std::array<float, 3> weight;
  float keep;
};

/// The rows beside a row. `composed`: some may be.
template <bool composed>
struct RowsBeside {
  std::array<float const*, 4> row;
  std::array<ComposedCell const*, 4> cells;
  float const* e;
  std::array<float, 3> weight;

  KOKKOS_INLINE_FUNCTION RowsBeside(LevelTables const& level, Row const& of, float const* values)
      : e(values), weight(level.weight) {
    for (int side = 0; side < 4; ++side) {
      std::int32_t const beside = of.beside[std::size_t(side)];
      row[std::size_t(side)] = beside >= 0 ? values + beside : nullptr;
      cells[std::size_t(side)] = beside >= 0 ? nullptr : &level.composed(~beside);
    }
  }
  KOKKOS_INLINE_FUNCTION float value(std::size_t side, int i) const {
    if constexpr (composed)
      if (row[side] == nullptr) return cells[side][i].factor * e[cells[side][i].source];
    return row[side][i];
  }
  /// The weighted sum over the neighbours of a cell.
  KOKKOS_INLINE_FUNCTION float sum(int i, float before, float after) const {
    return weighted_sum(weight, before + after, value(0, i) + value(1, i), value(2, i) + value(3, i));
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

  /// Part of `relax`, public because CUDA wants members with kernels to be.
  void half_sweep(Part const& rows, int colour, bool from_zero, int reach);

 private:
  void bring(int colours);

  matrixfree::SweptLevel& plan_;
  LevelTables tables_;
  Array<RowPlace> own_rows_;
  std::vector<std::int32_t> first_rows_;
  std::vector<Part> together_;  ///< rows that may be relaxed at once
  Mirrored<float> r_, e_;
  CellCopies halo_, edge_halo_;
  std::array<CellCopies, 2> halo_of_colour_;
  int stale_ = matrixfree::both_colours;
};

}  // namespace amrpic::kokkos
