#include "operators/copy_operators.hpp"

#include "operators/halos.hpp"
#include "operators/intergrid_rows.hpp"
#include "operators/near_levels.hpp"

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

/// `reads`: what any operator reads of the copy.
std::shared_ptr<LevelOperators> laplacian_of(Communicator const& comm, LevelCopy const& copy, CellReads const& reads,
                                             Real shift) {
  auto out = std::make_shared<LevelOperators>();
  Level const& level = *copy.level;
  out->level = copy.level;
  out->cells = std::make_shared<LevelCells const>(comm, copy.level, Halo(comm, reads), stencil_reads(level));
  Equation const equation = equation_on(level.spacing(), shift);
  Real3 const seam_width = seam_widths(level.periodic(), copy.upper);
  FormTable forms;
  RowForms rows(level.local_cells());
  NearPlaces places;
  LocalIndex const regular = forms.number(regular_laplacian(equation, FormsNear(level, copy.walls)));
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
    StencilCells const n = stencil_cells_of(BoxFaces(level, level.box(b)), level, {}, seam_width);
    places.add(out->cells->places(n.own_box()));
    for_each_run(row_kinds(n, Execution::without_finer), level.local_offset(b),
                 [&](RowKind kind, Index3 const& first, RowRun const& run) {
                   if (kind == RowKind::regular) return rows.set(run, regular);
                   for_each_in_run(first, run, [&](Index3 const& cell, LocalIndex row) {
                     rows.set(row, forms.number(special_row(equation, copy, n, cell)));
                   });
                 });
  }
  out->no_fine = filled(forms, rows, places, {}, *out->cells, *out->cells);
  return out;
}

/// A value of a copy, or of its ghost cell: emit(cell, weight). `places`: of the copy's cells. Ghost cells follow axis
/// after axis, on the first `passes` of the six sides.
template <class Emit>
bool emit_value(LevelCopy const& copy, ArrayOnBox<LocalIndex> const& places, Index3 const& cell, Real weight,
                int passes, Emit& emit) {
  if (!places.box().contains(cell)) return false;
  if (places(cell) != no_place) {
    emit(cell, weight);
    return true;
  }
  for (int pass = 0; pass < passes; ++pass) {
    int const axis = pass / 2, side = pass % 2;
    Index3 before = cell;
    before[axis] += side == 0 ? 1 : -1;
    if (places.box().contains(before) && emit_value(copy, places, before, 0, pass, emit))
      return emit_value(copy, places, before, weight * copy.prolonged(before, axis, side), pass, emit);
  }
  return false;
}

/// Means over the children.
SparseMatrix restriction_of(LevelCopy const& copy, LevelCells const& rows, LevelCells const& above) {
  Level const& level = *copy.level;
  FormTable forms;
  RowForms row_forms(level.local_cells());
  NearPlaces near;
  LocalIndex row = 0;
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
    auto const places = above.places(level.box(b).refine(copy.ratio));
    near.add(places);
    for_each_cell(level.box(b), [&](Index3 const& cell) {
      Index3 const anchor = Box{cell, cell}.refine(copy.ratio).lower;
      Form form;
      restrict_mean(cell, copy.ratio, above.level(), places, copy.children,
                    [&](Index3 const& child, Real w) { form.append(from_anchor(child, anchor), w); });
      row_forms.set(row++, forms.number(form));
    });
  }
  return filled(forms, row_forms, near, {copy.ratio, {1, 1, 1}}, rows, above);
}

/// Interpolation between the parents, or what stands for them behind the copy's ends.
SparseMatrix prolongation_of(LevelCopy const& copy, LevelCells const& rows, LevelCells const& own) {
  Level const& above = rows.level();
  Real3 const seam_width = seam_widths(copy.level->periodic(), copy.upper);
  FormTable forms;
  RowForms row_forms(above.local_cells());
  NearPlaces near;
  LocalIndex row = 0;
  for (int b = above.first_local_box(); b < above.last_local_box(); ++b) {
    auto const places = own.places(above.box(b).coarsen(copy.ratio).grow(1));
    near.add(places);
    for_each_cell(above.box(b), [&](Index3 const& cell) {
      Trilinear around{Box{cell, cell}.coarsen(copy.ratio).lower};
      for (int d = 0; d < 3; ++d)
        if (copy.ratio[d] == 2) around.interpolate(cell, d, *copy.level, seam_width[d]);
      Form form;
      auto emit = [&](Index3 const& source, Real w) {
        if (w != 0) form.add(from_anchor(source, around.parent), w);
      };
      around.for_each([&](Index3 const& source, Real weight) { emit_value(copy, places, source, weight, 6, emit); });
      row_forms.set(row++, forms.number(form));
    });
  }
  return filled(forms, row_forms, near, {{1, 1, 1}, copy.ratio}, rows, own);
}

}  // namespace

CopyOperators copy_operators(Communicator const& comm, std::shared_ptr<Level const> const& above, LevelCopy const& copy,
                             Real shift) {
  CopyOperators out;
  CellReads children(*above), own = stencil_reads(*copy.level);
  add_children(children, *copy.level, copy.ratio);
  own.add(  // parents
      *above, [&](Box const& o) { return o.grow(1).refine(copy.ratio); },
      [&](int b, auto&& read) { read(above->box(b).coarsen(copy.ratio).grow(1)); });
  out.level = laplacian_of(comm, copy, own, shift);
  out.above = std::make_shared<LevelCells const>(comm, above, Halo(comm, children));
  out.restriction = restriction_of(copy, *out.level->cells, *out.above);
  out.prolongation = prolongation_of(copy, *out.above, *out.level->cells);
  return out;
}

}  // namespace amrpic
