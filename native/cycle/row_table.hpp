#pragma once

#include <array>
#include <cstdint>

#include "cycle/rows.hpp"

namespace amrpic::cycle {

/// A row of cells of a block along x, and its neighbours. The row on a side is a piece of memory, or composed of runs.
struct Row {
  std::int32_t place;                  ///< of its first cell in a Vector
  std::array<std::int32_t, 4> beside;  ///< y below, above, z below, above: the place in a Vector, or ~(composed row)
  std::array<std::int32_t, 2> end;     ///< places of the values before the first and after the last cell
  std::array<float, 2> factor;         ///< of these
  std::int32_t coefficients;           ///< where the row's coefficients start
  std::int32_t pitch;                  ///< between these; whole vectors
  std::int32_t cells;
  std::int8_t lanes;   ///< cells in a vector of the host
  std::int8_t parity;  ///< of the places of colour 0
  std::int8_t steps;   ///< from own cells
};

/// A cell beside metal, see CutRow: its equation.
struct CutPlace {
  std::int32_t place;  ///< in the row
  std::array<float, 6> weight;
  float diagonal, step;  ///< `step`: relaxation / diagonal
};

/// The weighted sum over the neighbours of a cut cell.
KOKKOS_INLINE_FUNCTION float sum_beside(std::array<float, 6> const& weight, float left, float right, float below_y,
                                        float above_y, float below_z, float above_z) {
  return (weight[0] * left + weight[1] * right) + (weight[2] * below_y + weight[3] * above_y) +
         (weight[4] * below_z + weight[5] * above_z);
}

/// A run of cells in metal.
struct SolidRun {
  std::int32_t place, count;
};

/// What metal makes of a row: its cut cells, those of even places first, and its solid ones.
struct MetalRow {
  std::int32_t first_cut;
  std::array<std::int32_t, 2> cuts;
  std::int32_t first_solid, solids;
  bool is_solid;  ///< all of it
};

/// A run of values of a row: factor * e[source + i] for `count` cells from `place` on; of differences, factor *
/// (e[source + i] - e[own + i]).
struct ScaledRun {
  std::int32_t place;  ///< the composed row's number times the pitch of such rows, and the place in it
  std::int32_t count;
  std::int32_t source;
  float factor;
  std::int32_t own;  ///< the first of the cells that the row lies beside

  template <class Worker>
  KOKKOS_INLINE_FUNCTION void compose(float const* e, bool differences, float* to, Worker const& worker) const {
    float const *const from = e + source, *const beside = e + own, times = factor;
    if (differences)
      worker.for_each(count, [=](int i) { to[i] = times * (from[i] - beside[i]); });
    else
      worker.for_each(count, [=](int i) { to[i] = times * from[i]; });
  }
};

/// The operator h² L of a level as if nothing finer existed, h the smallest spacing, by rows: S e - d e, S the weighted
/// sum over neighbours, d the diagonal with what ghosts add to it. Its lists lie where acts on rows run.
struct RowTable {
  Row const* rows;
  ScaledRun const* runs;          ///< of composed rows
  std::int32_t const* first_run;  ///< composed row c: [first_run[c], first_run[c + 1])
  float const* coefficients;      ///< of a row: the diagonal d; relaxation / d of even places, and of odd ones; `held`
  std::int32_t const* metal_of;   ///< of each row: the number among `metal_rows`, or -1; null where no row has any
  MetalRow const* metal_rows;
  CutPlace const* cuts;
  SolidRun const* solids;
  float* cut_values;            ///< room for a value of each cut cell
  std::array<float, 3> weight;  ///< h² / h_d²
  bool isotropic;
  float keep;  ///< 1 - relaxation
  /// Whether residuals are taken of differences between neighbours, see `is_nearly_free`: the sum over neighbours less
  /// d e is then that over the differences to them less `held` times e.
  bool in_differences;
  std::int32_t zero_row;  ///< a row of zeros in a Vector
  std::int32_t composed_pitch;

  static constexpr int held_place = 3;  ///< among the vectors of a row's coefficients
  KOKKOS_INLINE_FUNCTION float const* diagonal(Row const& row) const { return coefficients + row.coefficients; }
  KOKKOS_INLINE_FUNCTION float const* step(Row const& row, int parity) const {
    return diagonal(row) + (1 + parity) * row.pitch;
  }
  KOKKOS_INLINE_FUNCTION float const* held(Row const& row) const { return diagonal(row) + held_place * row.pitch; }

  /// A row's correction and its neighbours', in vectors of so many cells; composed(side, number) has a composed row.
  /// A call in each row of the host would cost a 25th of a solve.
  template <int lanes, class Composed>
  KOKKOS_FORCEINLINE_FUNCTION CorrectionRow correction(Row const& row, float* e, Composed const& composed) const {
    CorrectionRow out;
    out.here = e + row.place;
    for (std::size_t side = 0; side < 4; ++side) out.beside[side] = e + row.beside[side];
    if ((row.beside[0] | row.beside[1] | row.beside[2] | row.beside[3]) < 0)
      for (std::size_t side = 0; side < 4; ++side)
        if (row.beside[side] < 0) out.beside[side] = composed(side, ~row.beside[side]);
    out.left = row.factor[0] * e[row.end[0]];
    out.right = row.factor[1] * e[row.end[1]];
    out.vectors = row.pitch / lanes;
    out.last = (row.cells - 1) % lanes;
    return out;
  }
  /// The same for a residual of differences.
  template <class Composed>
  KOKKOS_INLINE_FUNCTION DifferenceRow differences(Row const& row, float* e, Composed const& composed) const {
    DifferenceRow out{correction<1>(row, e, composed), {}, row.cells};
    for (std::size_t side = 0; side < 4; ++side)
      out.less[side] = row.beside[side] < 0 || row.beside[side] == zero_row ? e + zero_row : out.here;
    out.left = row.factor[0] * (e[row.end[0]] - out.here[0]);
    out.right = row.factor[1] * (e[row.end[1]] - out.here[row.cells - 1]);
    return out;
  }
  /// Whether metal is in a row, or beside its cells.
  KOKKOS_INLINE_FUNCTION bool has_metal(Row const& row) const { return metal_of && metal_of[&row - rows] >= 0; }
  KOKKOS_INLINE_FUNCTION MetalRow const& metal(Row const& row) const { return metal_rows[metal_of[&row - rows]]; }
  KOKKOS_INLINE_FUNCTION static float before(Row const&, CorrectionRow const& at, int i) {
    return i > 0 ? at.here[i - 1] : at.left;
  }
  KOKKOS_INLINE_FUNCTION static float after(Row const& row, CorrectionRow const& at, int i) {
    return i + 1 < row.cells ? at.here[i + 1] : at.right;
  }
  /// The sum over the neighbours of a cut cell.
  KOKKOS_INLINE_FUNCTION float sum(Row const& row, CorrectionRow const& at, CutPlace const& cut) const {
    int const i = cut.place;
    return sum_beside(cut.weight, before(row, at, i), after(row, at, i), at.beside[0][i], at.beside[1][i],
                      at.beside[2][i], at.beside[3][i]);
  }
  /// The weighted sum over the neighbours of a cell.
  KOKKOS_INLINE_FUNCTION float sum(Row const& row, CorrectionRow const& at, int i) const {
    return weighted_sum(weight, before(row, at, i) + after(row, at, i), at.beside[0][i] + at.beside[1][i],
                        at.beside[2][i] + at.beside[3][i]);
  }
};

}  // namespace amrpic::cycle
