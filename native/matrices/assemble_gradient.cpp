#include <utility>

#include "matrices/near_levels.hpp"
#include "matrices/operators.hpp"
#include "stencil/field_difference.hpp"

namespace amrpic {

namespace {

/// E along each axis in cells of a level.
class FieldForms {
 public:
  FieldForms(Level const& level, WallGhosts const& walls) : spacing_(level.spacing()), near_(level, walls) {}

  Form along(CellShape const& shape, int axis) const {
    return field_between(field_factor(spacing_[axis]), near_.across(shape[axis][0], axis, 0),
                         near_.across(shape[axis][1], axis, 1));
  }

 private:
  Real3 spacing_;
  FormsNear near_;
};

/// The rows of E along each axis, towards one level.
struct FieldRows {
  FormTable forms;
  std::array<RowForms, 3> axes;

  explicit FieldRows(LocalIndex rows) : axes{RowForms(rows), RowForms(rows), RowForms(rows)} {}
};

/// Names the rows of E in cells of a level, and fills them.
class FieldAssembly {
 public:
  /// `coarse`, `fine`: null where there is no such level.
  FieldAssembly(MultigridLevels const& multigrid, std::size_t l, LevelCells const& own, LevelCells const* coarse,
                LevelCells const* fine)
      : level_(own.level()),
        faces_(*multigrid.faces[l]),
        beside_(multigrid.beside(l)),
        forms_(level_, multigrid.walls[l]),
        levels_{&own, coarse, fine, refinement_ratio, refinement_ratio, {}, {}, {}},
        own_(own.rows()),
        coarse_(own.rows()),
        fine_(own.rows()) {
    for (int d = 0; d < 3; ++d) regular_[std::size_t(d)] = own_.forms.number(forms_.along({}, d));
  }

  /// In uncovered cells. Local.
  void name_rows(std::vector<char> const& uncovered) {
    for (int b = level_.first_local_box(); b < level_.last_local_box(); ++b) {
      StencilCells const n = stencil_cells_of(faces_[std::size_t(b - level_.first_local_box())], level_, beside_);
      levels_.add(level_.box(b), n, {});
      for_each_run(row_kinds(n, Execution::composite), level_.local_offset(b),
                   [&](RowKind kind, Index3 const& first, RowRun const& run) {
                     for_each_in_run(first, run, [&](Index3 const& cell, LocalIndex row) {
                       if (uncovered[std::size_t(row)]) name(kind, n, cell, row);
                     });
                   });
      levels_.add_own(n);
    }
  }

  /// Collective.
  std::array<GradientAxis, 3> all() const {
    std::array<GradientAxis, 3> out;
    for (std::size_t d = 0; d < 3; ++d) {
      out[d].own = levels_.to_own(own_.forms, own_.axes[d]);
      if (levels_.coarser) out[d].coarse = levels_.to_coarser(coarse_.forms, coarse_.axes[d]);
      if (levels_.finer) out[d].fine = levels_.to_finer(fine_.forms, fine_.axes[d]);
    }
    return out;
  }

 private:
  struct Numbers {
    LocalIndex own, coarse, fine;
  };

  void name(RowKind kind, StencilCells const& n, Index3 const& cell, LocalIndex row) {
    if (kind == RowKind::regular) {
      for (std::size_t d = 0; d < 3; ++d) own_.axes[d].set(row, regular_[d]);
      return;
    }
    CellShape const shape = cell_shape(n, cell, Execution::composite, gaps_);
    auto const& numbers = numbers_(shape, [&] {
      std::array<Numbers, 3> out;
      for (int d = 0; d < 3; ++d) {
        SplitForm const form(forms_.along(shape, d));
        out[std::size_t(d)] = {own_.forms.number(form.own), coarse_.forms.number(form.coarse),
                               fine_.forms.number(form.fine)};
      }
      return out;
    });
    for (std::size_t d = 0; d < 3; ++d) {
      own_.axes[d].set(row, numbers[d].own);
      coarse_.axes[d].set(row, numbers[d].coarse);
      fine_.axes[d].set(row, numbers[d].fine);
    }
  }

  Level const& level_;
  LevelFaces const& faces_;
  LevelsBeside beside_;
  FieldForms forms_;
  NearLevels levels_;
  FieldRows own_, coarse_, fine_;
  std::array<LocalIndex, 3> regular_{};
  GapFits gaps_;
  ByShape<std::array<Numbers, 3>> numbers_;
};

}  // namespace

void assemble_gradient(MultigridLevels const& multigrid, MultigridOperators const& operators) {
  for (std::size_t l = multigrid.base; l < multigrid.levels.size(); ++l) {
    LevelOperators& o = *operators[l];
    if (std::exchange(o.has_gradient, true)) continue;
    FieldAssembly assembly(multigrid, l, *o.cells, multigrid.refines(l) ? operators[l - 1]->cells.get() : nullptr,
                           multigrid.refines(l + 1) ? operators[l + 1]->cells.get() : nullptr);
    assembly.name_rows(o.uncovered);
    o.gradient = assembly.all();
  }
}

}  // namespace amrpic
