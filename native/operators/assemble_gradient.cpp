#include <utility>

#include "operators/forms.hpp"
#include "operators/operators.hpp"
#include "operators/regular_rows.hpp"
#include "stencil/field_difference.hpp"

namespace amrpic {

namespace {

/// E along each axis in cells of a level.
class FieldForms {
 public:
  FieldForms(Level const& level, WallGhosts const& walls) : spacing_(level.spacing()), near_(level, walls) {}

  std::array<Form, 3> const& operator()(StencilCells const& n, Index3 const& cell, Execution execution) {
    CellShape const shape = cell_shape(n, cell, execution, gaps_);
    return forms_(shape, [&] { return std::array<Form, 3>{along(shape, 0), along(shape, 1), along(shape, 2)}; });
  }

 private:
  Form along(CellShape const& shape, int axis) const {
    return field_between(field_factor(spacing_[axis]), near_.across(shape[axis][0], axis, 0),
                         near_.across(shape[axis][1], axis, 1));
  }

  Real3 spacing_;
  FormsNear near_;
  GapFits gaps_;
  ByShape<std::array<Form, 3>> forms_;
};

std::array<CrsBuilder, 3> builders(LocalIndex rows) { return {CrsBuilder(rows), CrsBuilder(rows), CrsBuilder(rows)}; }

/// Write the regular rows of the axes, and with them finish.
void fill_regular(Level const& level, Halo const& halo, std::array<CrsBuilder, 3>& axes) {
  for (CrsBuilder& axis : axes) axis.start_filling(halo);
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
    auto const places = halo.places(level, level.box(b).grow(1));
    RegularRows const regular(level.spacing(), 0, places);
    for (int d = 0; d < 3; ++d)
      axes[d].fill_runs(level.box(b), level.local_offset(b),
                        [&](auto const&... where) { regular.gradient(d, where...); });
  }
}

/// The axes of the gradient in the uncovered cells of a level; `coarser` and `finer` may be null.
std::array<GradientAxis, 3> gradient_of(MultigridLevels const& multigrid, std::size_t l, LevelOperators const* coarse,
                                        LevelOperators const& operators, LevelOperators const* fine) {
  Level const& level = *multigrid.levels[l];
  LevelsBeside const beside = multigrid.beside(l);
  LocalIndex const rows = level.local_cells();
  auto own = builders(rows), below = builders(rows), above = builders(rows);
  FieldForms forms(level, multigrid.walls[l]);
  Terms terms;
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
    BoxFaces const& faces = (*multigrid.faces[l])[std::size_t(b - level.first_local_box())];
    StencilCells const n = stencil_cells_of(faces, level, beside);
    auto const kinds = row_kinds(n, Execution::composite);
    for_each_run(kinds, level.local_offset(b), [&](RowKind kind, Index3 const& first, RowRun const& run) {
      for (int d = 0; d < 3 && kind == RowKind::regular; ++d) own[d].put_run(run, RegularRows::gradient_terms);
      if (kind == RowKind::regular || kind == RowKind::covered) return;
      for_each_in_run(first, run, [&](Index3 const& cell, LocalIndex row) {
        auto const& field = forms(n, cell, Execution::composite);
        for (int d = 0; d < 3; ++d) {
          terms.set(field[std::size_t(d)], n, cell);
          own[d].put(row, terms.own_row);
          below[d].put(row, terms.coarse_row);
          above[d].put(row, terms.fine_row);
        }
      });
    });
  }
  // Every cell that a face derivative reads is in the halo, since the Laplacian reads it too.
  fill_regular(level, operators.halo, own);
  std::array<GradientAxis, 3> out;
  for (int d = 0; d < 3; ++d) {
    below[d].start_filling(coarse ? coarse->halo : operators.halo);
    above[d].start_filling(fine ? fine->halo : operators.halo);
    out[d] = {own[d].take(), below[d].take(), above[d].take()};
  }
  return out;
}

}  // namespace

void assemble_gradient(MultigridLevels const& multigrid, MultigridOperators const& operators) {
  for (std::size_t l = multigrid.base; l < multigrid.levels.size(); ++l)
    if (!std::exchange(operators[l]->has_gradient, true))
      operators[l]->gradient = gradient_of(multigrid, l, multigrid.refines(l) ? operators[l - 1].get() : nullptr,
                                           *operators[l], multigrid.refines(l + 1) ? operators[l + 1].get() : nullptr);
}

std::array<Crs, 3> assemble_covered_gradient(MultigridLevels const& multigrid, std::size_t l,
                                             LevelOperators const& operators) {
  Level const& level = *multigrid.levels[l];
  auto axes = builders(level.local_cells());
  FieldForms forms(level, multigrid.walls[l]);
  Terms terms;
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
    // Levels nest, so the neighbours of a covered cell are cells of its level or lie behind a wall.
    BoxFaces const& faces = (*multigrid.faces[l])[std::size_t(b - level.first_local_box())];
    StencilCells const n = stencil_cells_of(faces, level, {});
    auto kinds = row_kinds(n, Execution::without_finer);
    std::size_t row = std::size_t(level.local_offset(b));
    for (RowKind& kind : kinds.values())
      if (operators.uncovered[row++]) kind = RowKind::covered;  // not wanted: stays empty
    for_each_run(kinds, level.local_offset(b), [&](RowKind kind, Index3 const& first, RowRun const& run) {
      for (int d = 0; d < 3 && kind == RowKind::regular; ++d) axes[d].put_run(run, RegularRows::gradient_terms);
      if (kind != RowKind::special) return;
      for_each_in_run(first, run, [&](Index3 const& cell, LocalIndex at) {
        auto const& field = forms(n, cell, Execution::without_finer);
        for (int d = 0; d < 3; ++d) {
          terms.set(field[std::size_t(d)], n, cell);
          axes[d].put(at, terms.own_row);
        }
      });
    });
  }
  fill_regular(level, operators.halo, axes);
  return {axes[0].take(), axes[1].take(), axes[2].take()};
}

}  // namespace amrpic
