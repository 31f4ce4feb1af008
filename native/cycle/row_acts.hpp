// The acts of a cycle on rows, for whoever works on one: a thread of the host by whole vectors, or a team by cells.
#pragma once

#include <algorithm>

#include "cycle/parents.hpp"
#include "cycle/row_kernels.hpp"
#include "cycle/row_table.hpp"

/// On the host what is rare stays out of loops over whole vectors. On a card a call would put all that it is given, and
/// the table of the level with it, into memory, for each cell.
#if defined(__CUDA_ARCH__) || defined(__HIP_DEVICE_COMPILE__)
#define AMRPIC_OUT_OF_LINE
#else
#define AMRPIC_OUT_OF_LINE [[gnu::noinline]]
#endif

namespace amrpic::cycle {

/// A thread of the host.
struct Thread {
  static constexpr bool has_vectors = true;
  template <class F>
  KOKKOS_INLINE_FUNCTION void for_each(int n, F const& f) const {
#pragma GCC ivdep
    for (int i = 0; i < n; ++i) f(i);
  }
  KOKKOS_INLINE_FUNCTION void barrier() const {}
};

/// Call f(cut cell, its number) for the cut cells of a row at places of some parity.
template <class Worker, class F>
KOKKOS_INLINE_FUNCTION void for_each_cut(RowTable const& level, Row const& row, int parity, Worker const& worker,
                                         F const& f) {
  MetalRow const& metal = level.metal(row);
  int const first = metal.first_cut + (parity == 0 ? 0 : metal.cuts[0]);
  worker.for_each(metal.cuts[std::size_t(parity)], [&](int n) { f(level.cuts[first + n], first + n); });
}

/// Set what metal makes zero in a row of values.
template <class Worker>
AMRPIC_OUT_OF_LINE KOKKOS_INLINE_FUNCTION void clear_solid(RowTable const& level, Row const& row, float* values,
                                                           Worker const& worker) {
  if (!level.has_metal(row)) return;
  MetalRow const& metal = level.metal(row);
  for (int n = 0; n < metal.solids; ++n) {
    SolidRun const run = level.solids[metal.first_solid + n];
    worker.for_each(run.count, [=](int i) { values[run.place + i] = 0; });
  }
}

// What is done to cut cells stays out of the loops over whole vectors.
/// The values of the cut cells at places of some parity after a step, into `cut_values`.
template <class Worker>
AMRPIC_OUT_OF_LINE KOKKOS_INLINE_FUNCTION void relax_cut(RowTable const& level, Row const& row, int parity,
                                                         CorrectionRow const& at, float const* right,
                                                         Worker const& worker) {
  for_each_cut(level, row, parity, worker, [&](CutPlace const& cut, int n) {
    int const i = cut.place;
    level.cut_values[n] = relaxed(level.keep, at.here[i], cut.step, level.sum(row, at, cut), right[i]);
  });
}
/// These put in place, and zeros in solid ones.
template <class Worker>
AMRPIC_OUT_OF_LINE KOKKOS_INLINE_FUNCTION void place_metal(RowTable const& level, Row const& row, int parity,
                                                           float* here, Worker const& worker) {
  worker.barrier();
  for_each_cut(level, row, parity, worker, [&](CutPlace const& cut, int n) { here[cut.place] = level.cut_values[n]; });
  clear_solid(level, row, here, worker);
}
/// One colour of the cut cells of a row relaxed.
template <class Composed, class Worker>
KOKKOS_INLINE_FUNCTION void relax_beside_metal(RowTable const& level, Row const& row, int colour,
                                               Composed const& composed, float const* r, float* e,
                                               Worker const& worker) {
  if (!level.has_metal(row)) return;
  int const parity = (row.parity + colour) & 1;
  CorrectionRow const at = level.correction<1>(row, e, composed);
  relax_cut(level, row, parity, at, r + row.place, worker);
  place_metal(level, row, parity, at.here, worker);
}
template <class Worker>
AMRPIC_OUT_OF_LINE KOKKOS_INLINE_FUNCTION void relax_metal_from_zero(RowTable const& level, Row const& row, int parity,
                                                                     float const* right, float* here,
                                                                     Worker const& worker) {
  worker.barrier();
  for_each_cut(level, row, parity, worker,
               [&](CutPlace const& cut, int) { here[cut.place] = relaxed_from_zero(cut.step, right[cut.place]); });
  clear_solid(level, row, here, worker);
}

/// One colour of a row relaxed, as if there were no metal.
template <int lanes, bool isotropic, class Worker>
KOKKOS_INLINE_FUNCTION void relax(RowTable const& level, Row const& row, int parity, CorrectionRow const& at,
                                  float const* right, Worker const& worker) {
  float const* const step = level.step(row, parity);
  if constexpr (Worker::has_vectors)
    relax<lanes, isotropic>(at, level.weight, right, step, level.keep, parity);
  else
    worker.for_each((row.cells - parity + 1) / 2, [&](int half) {
      int const i = 2 * half + parity;
      at.here[i] = relaxed(level.keep, at.here[i], step[i], level.sum(row, at, i), right[i]);
    });
}

/// One colour of a row relaxed. Beside metal cut cells take no part in what is done to whole vectors: as cells of one
/// colour do not see each other, their values are found before and put in place after it, with zeros in solid ones.
template <int lanes, bool isotropic, bool with_metal, class Composed, class Worker>
KOKKOS_INLINE_FUNCTION void relax(RowTable const& level, Row const& row, int colour, Composed const& composed,
                                  float const* r, float* e, Worker const& worker) {
  int const parity = (row.parity + colour) & 1;
  bool const has_metal = with_metal && level.has_metal(row);
  if (has_metal && level.metal(row).is_solid) return;
  CorrectionRow const at = level.correction<lanes>(row, e, composed);
  float const* const right = r + row.place;
  if (has_metal) relax_cut(level, row, parity, at, right, worker);
  relax<lanes, isotropic>(level, row, parity, at, right, worker);
  if (has_metal) place_metal(level, row, parity, at.here, worker);
}

/// The same from zero: the other colour becomes zero.
template <int lanes, bool with_metal, class Worker>
KOKKOS_INLINE_FUNCTION void relax_from_zero(RowTable const& level, Row const& row, int colour, float const* r, float* e,
                                            Worker const& worker) {
  int const parity = (row.parity + colour) & 1;
  float const *const right = r + row.place, *const step = level.step(row, parity);
  float* const here = e + row.place;
  if constexpr (Worker::has_vectors)
    relax_from_zero<lanes>(here, right, step, row.pitch / lanes);
  else
    worker.for_each(row.pitch, [=](int i) { here[i] = relaxed_from_zero(step[i], right[i]); });
  if (with_metal && level.has_metal(row)) relax_metal_from_zero(level, row, parity, right, here, worker);
}

constexpr int chunk = 256;  ///< cells of a row of which a thread of the host has residuals in flight

/// A row of children of which parents take residuals, or right-hand sides, cell by cell.
template <bool of_residual, bool with_metal>
struct ChildRow {
  RowTable const& level;
  Row const& row;
  float const* r;
  DifferenceRow at;

  template <class Composed>
  KOKKOS_INLINE_FUNCTION ChildRow(RowTable const& table, Row const& of, Composed const& composed, float* e,
                                  float const* all_r)
      : level(table), row(of), r(all_r + of.place) {
    if constexpr (of_residual)
      at = level.in_differences ? level.differences(row, e, composed)
                                : DifferenceRow{level.template correction<1>(row, e, composed), {}, row.cells};
  }

  KOKKOS_INLINE_FUNCTION float operator()(int i) const {
    if (with_metal && level.has_metal(row)) {
      MetalRow const& metal = level.metal(row);
      for (int n = 0; n < metal.solids; ++n) {
        SolidRun const run = level.solids[metal.first_solid + n];
        if (i >= run.place && i < run.place + run.count) return 0;
      }
      int const cuts = metal.cuts[0] + metal.cuts[1];
      for (int n = 0; of_residual && n < cuts; ++n)
        if (CutPlace const& cut = level.cuts[metal.first_cut + n]; cut.place == i)
          return remaining(r[i], level.sum(row, at, cut), cut.diagonal, at.here[i]);
    }
    if (!of_residual) return r[i];
    if (level.in_differences) return at.remaining(level.weight, r[i], level.held(row)[i], i);
    return remaining(r[i], level.sum(row, at, i), level.diagonal(row)[i], at.here[i]);
  }
};

/// Set what metal makes zero in a part of a row of values.
inline void clear_solid_in(RowTable const& level, Row const& row, int first, int count, float* values) {
  MetalRow const& metal = level.metal(row);
  for (int n = metal.first_solid; n < metal.first_solid + metal.solids; ++n) {
    SolidRun const run = level.solids[n];
    int const begin = std::max(first, run.place), end = std::min(first + count, run.place + run.count);
    for (int i = begin; i < end; ++i) values[i - first] = 0;
  }
}

/// Residuals of some cells of a row, set as if there were no metal: those of cut and solid cells.
[[gnu::noinline]] inline void residuals_beside_metal(RowTable const& level, Row const& row, CorrectionRow const& at,
                                                     float const* r, int first, int count, float* left) {
  MetalRow const& metal = level.metal(row);
  for (int n = metal.first_cut; n < metal.first_cut + metal.cuts[0] + metal.cuts[1]; ++n) {
    CutPlace const& cut = level.cuts[n];
    if (int const i = cut.place; i >= first && i < first + count)
      left[i - first] = remaining(r[i], level.sum(row, at, cut), cut.diagonal, at.here[i]);
  }
  clear_solid_in(level, row, first, count, left);
}

/// Add `weight` times the sums of residuals in pairs, or of single ones, to parents, or set these, part by part.
template <int lanes, bool isotropic, bool has_metal>
inline void restrict_residuals(RowTable const& level, Row const& row, CorrectionRow const& whole, float const* r,
                               Parents const& parents, float weight, bool set, float* to) {
  auto const restrict_part = [&](CorrectionRow const& at, int first, int cells) {
    alignas(64) float left[chunk + 2 * widest];  // no vector straddles two cache lines
    residual<lanes, isotropic>(at, level.weight, r + first, level.diagonal(row) + first, left);
    if (has_metal) residuals_beside_metal(level, row, whole, r, first, cells, left);
    restrict_row<lanes>(left, parents.over_ratio(0, cells), parents.ratio[0], weight, set,
                        to + parents.over_ratio(0, first));
  };
  if (row.cells <= chunk) return restrict_part(whole, 0, row.cells);  // without copies of it, which would wait
  CorrectionRow at = whole;
  at.last = lanes - 1, at.vectors = chunk / lanes;
  int first = 0;
  for (; first + chunk < row.cells; first += chunk) {
    at.right = at.here[chunk];
    restrict_part(at, first, chunk);
    at.left = at.here[chunk - 1];
    at.here += chunk;
    for (float const*& beside : at.beside) beside += chunk;
  }
  at.right = whole.right, at.last = whole.last, at.vectors = (row.pitch - first) / lanes;
  restrict_part(at, first, row.cells - first);
}

/// Row (y, z) of the parents of a block: `weight` times the sums of the children's residuals, or of their right-hand
/// sides. `rows`: of the block, ny x nz.
template <bool of_residual, bool with_metal, class Composed, class Worker>
KOKKOS_INLINE_FUNCTION void restrict_to(Parents const& parents, int y, int z, RowTable const& level, Row const* rows,
                                        int ny, int nz, float weight, Composed const& composed, float const* r,
                                        float* e, float* coarse, Worker const& worker) {
  float* const to = coarse + parents.cells.place(0, y, z);
  bool set = true;
  auto const for_each_child_row = [&](auto const& f) {
    int const end_j = parents.end_of_children(1, y, ny), end_k = parents.end_of_children(2, z, nz);
    for (int k = parents.first_child(2, z); k < end_k; ++k)
      for (int j = parents.first_child(1, y); j < end_j; ++j, set = false)
        f(rows[j + ny * k], weight * parents.weight_of(1, j) * parents.weight_of(2, k));
  };
  if constexpr (Worker::has_vectors)
    if (!level.in_differences && parents.last[0] < 0 && parents.odd[0] == 0 &&
        (rows->cells & (parents.ratio[0] - 1)) == 0)
      return with_kind(rows->lanes, level.isotropic, [&](auto lanes, auto isotropic) {
        for_each_child_row([&](Row const& row, float of_row) {
          if constexpr (of_residual) {
            auto const act = [&](auto has_metal) {
              restrict_residuals<lanes(), isotropic(), has_metal()>(
                  level, row, level.template correction<lanes()>(row, e, composed), r + row.place, parents, of_row, set,
                  to);
            };
            if constexpr (with_metal)
              if (level.has_metal(row)) return act(std::true_type());
            act(std::false_type());
          } else  // zero in metal
            restrict_row<lanes()>(r + row.place, parents.over_ratio(0, row.cells), parents.ratio[0], of_row, set, to);
        });
      });
  for_each_child_row([&](Row const& of, float of_row) {
    ChildRow<of_residual, with_metal> const row(level, of, composed, e, r);
    worker.for_each(parents.extent[0], [&](int p) {
      float sum = 0;
      for (int i = parents.first_child(0, p); i < parents.end_of_children(0, p, of.cells); ++i)
        sum += parents.weight_of(0, i) * row(i);
      to[p] = (set ? 0 : to[p]) + of_row * sum;
    });
  });
}

/// Row (j, k) of a block set to the coarse correction, interpolated trilinearly along the axes of ratio 2, or this
/// added; ghost cells of the block's parents are filled. Sweeps that follow read r.
template <int lanes, class Worker>
KOKKOS_INLINE_FUNCTION void prolong(Parents const& parents, int j, int k, Row const& row, float const* coarse, bool set,
                                    float const* r, float* e, Worker const& worker) {
  CoarseRows const from = parents.rows_of(j, k, coarse);
  float* const to = e + row.place;
  int const ratio = parents.ratio[0];
  if constexpr (Worker::has_vectors)
    if (parents.odd[0] == 0 && parents.seam[0] == 0)
      return prolong_row<lanes>(from, ratio, row.pitch / lanes, set, r + row.place, to);
  worker.for_each(row.cells, [&](int i) {
    int const p = parents.parent(0, i);
    float const here = mean(from, p);
    to[i] = (set ? 0 : to[i]) +
            (ratio == 1 ? here : prolonged(parents.far(0, i), here, mean(from, p + parents.toward(0, i))));
  });
}

}  // namespace amrpic::cycle
