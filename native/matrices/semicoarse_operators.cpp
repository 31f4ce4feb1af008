#include "matrices/semicoarse_operators.hpp"

#include "matrices/halos.hpp"
#include "matrices/intergrid_rows.hpp"
#include "matrices/near_levels.hpp"

namespace amrpic {

namespace {

/// The row of a cell that lacks a neighbour, has one twice, lies at a seam, or is `cut`; null if it is not.
Form special_row(Equation const& equation, SemicoarsenedLevel const& semicoarse, StencilCells const& n,
                 Index3 const& cell, CutCell const* cut = nullptr) {
  FormsNear const near(*semicoarse.level, semicoarse.walls);
  GapFits no_gaps;  // its ends have ghosts of their own
  auto const across = [&](int axis, int side) {
    CellFaces const& faces = n.faces(cell);
    if (faces(axis, side) == Beyond::same_level)
      return near.across(face_shape(n, cell, axis, side, Execution::without_finer, no_gaps), axis, side);
    WallGhost ghost =
        faces(axis, side) == Beyond::wall ? semicoarse.walls[axis][side] : semicoarse.ghost(cell, axis, side);
    if (faces(axis, 1 - side) != Beyond::same_level) ghost.second = 0;
    return ghost(near.own(), near.own(axis, side == 0 ? 1 : -1));
  };
  if (!cut) return laplacian_form(equation, near.own(), across);
  auto const is_parabola = [&](int axis, int side) {
    return n.faces(cell)(axis, side) == Beyond::wall && semicoarse.walls[axis][side].second != 0;
  };
  return cut_laplacian_form(equation, near.own(), *cut, is_parabola, across);
}

/// `reads`: what any operator reads of the semicoarse.
std::shared_ptr<LevelOperators> laplacian_of(Communicator const& comm, SemicoarsenedLevel const& semicoarse,
                                             CellReads const& reads, Real shift, MetalCells const& metal) {
  auto out = std::make_shared<LevelOperators>();
  Level const& level = *semicoarse.level;
  out->level = semicoarse.level;
  out->cells = std::make_shared<LevelCells const>(comm, semicoarse.level, Halo(comm, reads), stencil_reads(level));
  Equation const equation = equation_on(level.spacing(), shift);
  Real3 const seam_width = seam_widths(level.periodic(), semicoarse.upper);
  FormTable forms;
  RowForms rows(level.local_cells());
  NearPlaces places;
  FormsNear const near(level, semicoarse.walls);
  LocalIndex const regular = forms.number(regular_laplacian(equation, near));
  LocalIndex const held = forms.number(-equation.diagonal() * near.own());
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
    StencilCells const n = stencil_cells_of(BoxFaces(level, level.box(b)), level, {}, seam_width);
    places.add(out->cells->places(n.own_box()));
    for_each_run(row_kinds(n, Execution::without_finer), level.local_offset(b),
                 [&](RowKind kind, Index3 const& first, RowRun const& run) {
                   if (kind == RowKind::regular) return rows.set(run, regular);
                   for_each_in_run(first, run, [&](Index3 const& cell, LocalIndex row) {
                     rows.set(row, forms.number(special_row(equation, semicoarse, n, cell)));
                   });
                 });
    for_each_row(level.box(b), [&](Index3 const& first) {
      LocalIndex const row = level.local_offset(b) + LocalIndex(level.box(b).offset(first));
      metal.for_each_cut(first, level.box(b).extent(0), [&](CutCell const& cut) {
        rows.set(row + cut.cell[0] - first[0], forms.number(special_row(equation, semicoarse, n, cut.cell, &cut)));
      });
      metal.for_each_solid(first, level.box(b).extent(0),
                           [&](SolidCell const& solid) { rows.set(row + solid.cell[0] - first[0], held); });
    });
  }
  out->no_fine = filled(forms, rows, places, {}, *out->cells, *out->cells);
  return out;
}

/// A value of a level, or of its ghost cell: emit(cell, weight). `places`: of the level's cells. Ghost cells follow
/// axis after axis, on the first `passes` of the six sides.
template <class Emit>
bool emit_value(SemicoarsenedLevel const& semicoarse, ArrayOnBox<LocalIndex> const& places, Index3 const& cell,
                Real weight, int passes, Emit& emit) {
  if (!places.box().contains(cell)) return false;
  if (places(cell) != no_place) {
    emit(cell, weight);
    return true;
  }
  for (int pass = 0; pass < passes; ++pass) {
    int const axis = pass / 2, side = pass % 2;
    Index3 before = cell;
    before[axis] += side == 0 ? 1 : -1;
    if (places.box().contains(before) && emit_value(semicoarse, places, before, 0, pass, emit))
      return emit_value(semicoarse, places, before, weight * semicoarse.prolonged(before, axis, side), pass, emit);
  }
  return false;
}

/// Means over the children.
SparseMatrix restriction_of(SemicoarsenedLevel const& semicoarse, LevelCells const& rows, LevelCells const& above) {
  Level const& level = *semicoarse.level;
  FormTable forms;
  RowForms row_forms(level.local_cells());
  NearPlaces near;
  LocalIndex row = 0;
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
    auto const places = above.places(level.box(b).refine(semicoarse.ratio));
    near.add(places);
    for_each_cell(level.box(b), [&](Index3 const& cell) {
      Index3 const anchor = Box{cell, cell}.refine(semicoarse.ratio).lower;
      Form form;
      restrict_mean(cell, semicoarse.ratio, above.level(), places, semicoarse.children,
                    [&](Index3 const& child, Real w) { form.append(from_anchor(child, anchor), w); });
      row_forms.set(row++, forms.number(form));
    });
  }
  return filled(forms, row_forms, near, {semicoarse.ratio, {1, 1, 1}}, rows, above);
}

/// Interpolation between the parents, or what stands for them behind the level's ends; to no cell in metal.
SparseMatrix prolongation_of(SemicoarsenedLevel const& semicoarse, LevelCells const& rows, LevelCells const& own,
                             MetalCells const& metal) {
  Level const& above = rows.level();
  Real3 const seam_width = seam_widths(semicoarse.level->periodic(), semicoarse.upper);
  FormTable forms;
  RowForms row_forms(above.local_cells());
  NearPlaces near;
  LocalIndex row = 0;
  for (int b = above.first_local_box(); b < above.last_local_box(); ++b) {
    auto const places = own.places(above.box(b).coarsen(semicoarse.ratio).grow(1));
    near.add(places);
    for_each_cell(above.box(b), [&](Index3 const& cell) {
      if (metal.solid_at(cell)) return void(++row);
      Trilinear around{Box{cell, cell}.coarsen(semicoarse.ratio).lower};
      for (int d = 0; d < 3; ++d)
        if (semicoarse.ratio[d] == 2) around.interpolate(cell, d, *semicoarse.level, seam_width[d]);
      Form form;
      auto emit = [&](Index3 const& source, Real w) {
        if (w != 0) form.add(from_anchor(source, around.parent), w);
      };
      around.for_each(
          [&](Index3 const& source, Real weight) { emit_value(semicoarse, places, source, weight, 6, emit); });
      row_forms.set(row++, forms.number(form));
    });
  }
  return filled(forms, row_forms, near, {{1, 1, 1}, semicoarse.ratio}, rows, own);
}

}  // namespace

SemicoarseOperators semicoarse_operators(Communicator const& comm, std::shared_ptr<Level const> const& finer,
                                         SemicoarsenedLevel const& level, Real shift,
                                         std::array<MetalCells, 2> const& metal) {
  SemicoarseOperators out;
  CellReads children(*finer), own = stencil_reads(*level.level);
  add_children(children, *level.level, level.ratio);
  own.add(  // parents
      *finer, [&](Box const& o) { return o.grow(1).refine(level.ratio); },
      [&](int b, auto&& read) { read(finer->box(b).coarsen(level.ratio).grow(1)); });
  out.level = laplacian_of(comm, level, own, shift, metal[0]);
  out.finer = std::make_shared<LevelCells const>(comm, finer, Halo(comm, children));
  out.level->restriction = restriction_of(level, *out.level->cells, *out.finer);
  out.prolongation = prolongation_of(level, *out.finer, *out.level->cells, metal[1]);
  return out;
}

}  // namespace amrpic
