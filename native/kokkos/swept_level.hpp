#pragma once

#include <array>

#include "cycle/row_acts.hpp"
#include "cycle/swept_level.hpp"
#include "kokkos/cell_copies.hpp"

namespace amrpic::kokkos {

/// Which row of which own block a row is.
struct RowPlace {
  std::int32_t block;
  std::int32_t j, k;  ///< counted from the block's first
};

/// The row table of a level, and its composed rows, in the kernels' memory.
struct LevelTables : cycle::RowTable {
  float* composed;

  /// Where composed rows are.
  struct Composed {
    float const* first;
    std::int32_t pitch;
    KOKKOS_INLINE_FUNCTION float const* operator()(std::size_t, std::int32_t number) const {
      return first + number * pitch;
    }
  };
  KOKKOS_INLINE_FUNCTION Composed composed_rows() const { return {composed, composed_pitch}; }
};

/// A level of the cycle in the kernels' memory: the sweeps of a cycle::SweptLevel, each half of one kernel over
/// all rows. The two share what they are made of, and on the host the values.
class SweptLevel {
 public:
  /// `plan` must outlive this. Collective.
  SweptLevel(Communicator const& comm, cycle::SweptLevel& plan);

  /// See cycle::SweptLevel. All are collective.
  void relax(int sweeps, bool from_zero, int further) { relax(cycle::Relaxed::all, sweeps, from_zero, further); }
  void relax_beside_metal(int further) {
    if (plan_.may_have_metal()) relax(cycle::Relaxed::beside_metal, 1, false, further);
  }
  void exchange_right_hand_sides();
  void exchange_corrections(bool boundary_changed);
  void finish() {}
  void corrections_are_new() { stale_ = cycle::both_colours; }
  /// Bring what a residual in own cells reads.
  void prepare_residual();

  LevelTables const& tables() const { return tables_; }
  Array<RowPlace> const& own_rows() const { return own_rows_; }
  Mirrored<float> const& right_hand_side() const { return r_; }
  Mirrored<float> const& correction() const { return e_; }
  cycle::SweptLevel& plan() const { return plan_; }

  std::size_t bytes() const;

  // Parts of `relax`, public because CUDA wants members with kernels to be.
  void compose(Range const& runs, bool differences);
  template <bool with_metal>
  void half_sweep(Range const& rows, cycle::HalfSweep const& half, int reach);
  void half_sweep_beside_metal(Range const& rows, cycle::HalfSweep const& half, int reach);

 private:
  void relax(cycle::Relaxed cells, int sweeps, bool from_zero, int further);
  void bring(int colours);

  cycle::SweptLevel& plan_;
  Array<cycle::Row> rows_;
  Array<cycle::ScaledRun> runs_;
  Array<std::int32_t> metal_of_;
  Array<cycle::MetalRow> metal_rows_;
  Array<cycle::CutPlace> cuts_;
  Array<cycle::SolidRun> solids_;
  Array<float> composed_, coefficients_, cut_values_;
  LevelTables tables_;
  Array<RowPlace> own_rows_;
  struct Together {
    Range rows, runs;
  };
  std::vector<Together> together_;  ///< rows that may be relaxed at once, and what composes those beside them
  Mirrored<float> r_, e_;
  CellCopies halo_, edge_halo_;
  std::array<CellCopies, 2> halo_of_colour_;
  int stale_ = cycle::both_colours;
};

}  // namespace amrpic::kokkos
