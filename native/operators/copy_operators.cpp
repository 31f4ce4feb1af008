#include "operators/copy_operators.hpp"

#include "operators/forms.hpp"
#include "operators/intergrid_rows.hpp"
#include "operators/regular_rows.hpp"

namespace amrpic {

namespace {

/// The row of a cell that lacks a neighbour, has one twice, or lies at a seam.
Form special_row(Equation const& equation, LevelCopy const& copy, StencilCells const& n, Index3 const& cell) {
  return laplacian_form(equation, n.own(cell), [&](int axis, int side) {
    CellFaces const& faces = n.faces(cell);
    if (faces(axis, side) == Beyond::same_level) return neighbour_value(n, cell, axis, side, Execution::without_finer);
    WallGhost ghost = faces(axis, side) == Beyond::wall ? copy.walls[axis][side] : copy.ghost(cell, axis, side);
    if (faces(axis, 1 - side) != Beyond::same_level) ghost.second = 0;
    Index3 inner = cell;
    inner[axis] += side == 0 ? 1 : -1;
    return ghost(own(n.own(cell)), own(n.own(inner)));
  });
}

LevelOperators laplacian_of(MPI_Comm comm, LevelCopy const& copy, Real shift) {
  LevelOperators out;
  out.level = copy.level;
  Level const& level = *copy.level;
  Equation const equation = equation_on(level.spacing(), shift);
  Real3 const seam_width = seam_widths(level.periodic(), copy.upper);
  CrsBuilder builder(level.local_cells(), level);
  Terms terms;
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
    StencilCells const n =
        stencil_cells_of(BoxFaces(level, level.box(b)), level, nullptr, nullptr, copy.walls, seam_width);
    auto const kinds = row_kinds(n, Execution::without_finer);
    for_each_run(kinds, level.local_offset(b), [&](RowKind kind, Index3 const& first, RowRun const& run) {
      if (kind == RowKind::regular) return builder.put_run(run, RegularRows::laplacian_terms);
      for_each_in_run(first, run, [&](Index3 const& cell, LocalIndex row) {
        terms.set(special_row(equation, copy, n, cell));
        builder.put(row, terms.own_row);
      });
    });
  }
  std::vector<GlobalIndex> remote;
  builder.append_remote(remote);
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b)
    append_remote_neighbours(level, level.box(b), remote);
  out.halo = Exchange(comm, level, remote_cells(level, std::move(remote)));
  out.stencil_halo = Exchange(comm, level, out.halo.halo_numbers());
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

CopyOperators copy_operators(MPI_Comm comm, Level const& above, LevelCopy const& copy, Real shift) {
  CopyOperators out;
  out.level = laplacian_of(comm, copy, shift);
  Level const& level = *copy.level;
  Row row;

  CrsBuilder restriction(level.local_cells(), above);
  LocalIndex at = 0;
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b)
    for_each_cell(level.box(b), [&](Index3 const& cell) {
      row.clear();
      restrict_mean(cell, copy.ratio, above, copy.children, [&](GlobalIndex c, Real w) { row.append(c, w); });
      restriction.put(at++, row);
    });
  Real3 const seam_width = seam_widths(level.periodic(), copy.upper);
  CrsBuilder prolongation(above.local_cells(), level);
  at = 0;
  for (int b = above.first_local_box(); b < above.last_local_box(); ++b) {
    auto const number = cell_numbers(level, above.box(b).coarsen(copy.ratio).grow(1));
    for_each_cell(above.box(b), [&](Index3 const& cell) {
      row.clear();
      auto emit = [&](GlobalIndex c, Real w) {
        if (w != 0) row.add(c, w);
      };
      Index3 const parent = Box{cell, cell}.coarsen(copy.ratio).lower;
      for (int corner = 0; corner < 8; ++corner) {
        Real weight = 1;
        Index3 source = parent;
        for (int d = 0; d < 3; ++d) {
          bool const other = (corner >> d) & 1;
          if (copy.ratio[d] == 1) {
            weight *= other ? 0 : 1;
          } else {
            int const side = cell[d] == 2 * parent[d] ? 0 : 1;
            Real const far = level.periodic()[d]
                                 ? prolonged_far(parent[d], side, level.domain().extent(d), seam_width[d])
                                 : prolongation::far;
            weight *= other ? far : 1 - far;
            if (other) source[d] += 2 * side - 1;
          }
        }
        if (weight != 0) emit_value(copy, number, source, weight, 6, emit);
      }
      prolongation.put(at++, row);
    });
  }
  auto finish = [&](CrsBuilder& builder, Level const& columns, Exchange& exchange, Crs& matrix) {
    std::vector<GlobalIndex> remote;
    builder.append_remote(remote);
    exchange = Exchange(comm, columns, remote_cells(columns, std::move(remote)));
    builder.start_filling(exchange);
    matrix = builder.take();
  };
  finish(restriction, above, out.above, out.restriction);
  finish(prolongation, level, out.own, out.prolongation);
  return out;
}

}  // namespace amrpic
