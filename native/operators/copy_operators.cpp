#include "operators/copy_operators.hpp"

#include "operators/forms.hpp"
#include "operators/halos.hpp"
#include "operators/intergrid_rows.hpp"
#include "operators/regular_rows.hpp"

namespace amrpic {

namespace {

/// The row of a cell that lacks a neighbour, has one twice, or lies at a seam.
Form special_row(Equation const& equation, LevelCopy const& copy, StencilCells const& n, Index3 const& cell) {
  FormsNear const near(*copy.level, copy.walls);
  GapFits no_gaps;  // a copy's ends have ghosts of their own
  return laplacian_form(equation, near.own(), [&](int axis, int side) {
    CellFaces const& faces = n.faces(cell);
    if (faces(axis, side) == Beyond::same_level)
      return near.across(face_shape(n, cell, axis, side, Execution::without_finer, no_gaps), axis, side);
    WallGhost ghost = faces(axis, side) == Beyond::wall ? copy.walls[axis][side] : copy.ghost(cell, axis, side);
    if (faces(axis, 1 - side) != Beyond::same_level) ghost.second = 0;
    return ghost(near.own(), near.own(axis, side == 0 ? 1 : -1));
  });
}

LevelOperators laplacian_of(Communicator const& comm, LevelCopy const& copy, Real shift) {
  LevelOperators out;
  out.level = copy.level;
  Level const& level = *copy.level;
  Equation const equation = equation_on(level.spacing(), shift);
  Real3 const seam_width = seam_widths(level.periodic(), copy.upper);
  CrsBuilder builder(level.local_cells());
  Terms terms;
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
    StencilCells const n = stencil_cells_of(BoxFaces(level, level.box(b)), level, {}, seam_width);
    auto const kinds = row_kinds(n, Execution::without_finer);
    for_each_run(kinds, level.local_offset(b), [&](RowKind kind, Index3 const& first, RowRun const& run) {
      if (kind == RowKind::regular) return builder.put_run(run, RegularRows::laplacian_terms);
      for_each_in_run(first, run, [&](Index3 const& cell, LocalIndex row) {
        terms.set(special_row(equation, copy, n, cell), n, cell);
        builder.put(row, terms.own_row);
      });
    });
  }
  out.halo = out.stencil_halo = Halo(comm, stencil_reads(level));
  builder.start_filling(out.halo);
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
    auto const places = out.halo.places(level, level.box(b).grow(1));
    RegularRows const regular(level.spacing(), shift, places);
    builder.fill_runs(level.box(b), level.local_offset(b), [&](auto const&... where) { regular.laplacian(where...); });
  }
  out.no_fine = builder.take();
  return out;
}

/// A value of a copy, or of its ghost cell: emit(cell number, weight). Ghost cells follow axis after axis, on the first
/// `passes` of the six sides.
template <class Emit>
bool emit_value(LevelCopy const& copy, ArrayOnBox<GlobalIndex> const& number, Index3 const& cell, Real weight,
                int passes, Emit& emit) {
  if (!number.box().contains(cell)) return false;
  if (number(cell) != no_cell) {
    emit(number(cell), weight);
    return true;
  }
  for (int pass = 0; pass < passes; ++pass) {
    int const axis = pass / 2, side = pass % 2;
    Index3 before = cell;
    before[axis] += side == 0 ? 1 : -1;
    if (number.box().contains(before) && emit_value(copy, number, before, 0, pass, emit))
      return emit_value(copy, number, before, weight * copy.prolonged(before, axis, side), pass, emit);
  }
  return false;
}

}  // namespace

CopyOperators copy_operators(Communicator const& comm, Level const& above, LevelCopy const& copy, Real shift) {
  CopyOperators out;
  out.level = laplacian_of(comm, copy, shift);
  Level const& level = *copy.level;
  Row row;

  CrsBuilder restriction(level.local_cells());
  LocalIndex at = 0;
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b)
    for_each_cell(level.box(b), [&](Index3 const& cell) {
      row.clear();
      restrict_mean(cell, copy.ratio, above, copy.children, [&](GlobalIndex c, Real w) { row.append(c, w); });
      restriction.put(at++, row);
    });
  Real3 const seam_width = seam_widths(level.periodic(), copy.upper);
  CrsBuilder prolongation(above.local_cells());
  at = 0;
  for (int b = above.first_local_box(); b < above.last_local_box(); ++b) {
    auto const number = cell_numbers(level, above.box(b).coarsen(copy.ratio).grow(1));
    for_each_cell(above.box(b), [&](Index3 const& cell) {
      row.clear();
      auto emit = [&](GlobalIndex c, Real w) {
        if (w != 0) row.add(c, w);
      };
      Trilinear around{Box{cell, cell}.coarsen(copy.ratio).lower};
      for (int d = 0; d < 3; ++d)
        if (copy.ratio[d] == 2) around.interpolate(cell, d, level, seam_width[d]);
      around.for_each([&](Index3 const& source, Real weight) { emit_value(copy, number, source, weight, 6, emit); });
      prolongation.put(at++, row);
    });
  }
  CellReads children(above), parents(level);
  add_children(children, level, copy.ratio);
  parents.add(
      above, [&](Box const& o) { return o.grow(1).refine(copy.ratio); },
      [&](int b, auto&& read) { read(above.box(b).coarsen(copy.ratio).grow(1)); });
  auto finish = [&](CrsBuilder& builder, CellReads const& reads, Halo& halo, Crs& matrix) {
    halo = Halo(comm, reads);
    builder.start_filling(halo);
    matrix = builder.take();
  };
  finish(restriction, children, out.above, out.restriction);
  finish(prolongation, parents, out.own, out.prolongation);
  return out;
}

}  // namespace amrpic
