#pragma once

#include "matrices/forms.hpp"
#include "matrices/row_forms.hpp"

namespace amrpic {

/// A form as forms on three levels, each with the unknowns of one.
struct SplitForm {
  Form own, coarse, fine;

  SplitForm() = default;
  explicit SplitForm(Form const& form) {
    for (auto const& [unknown, weight] : form.terms())
      (unknown.level == Unknown::On::own       ? own
       : unknown.level == Unknown::On::coarser ? coarse
                                               : fine)
          .append(unknown, weight);
  }
};

/// Where the cells lie that rows of a level's boxes read: on the level itself and on the next coarser and finer ones,
/// either of which may be missing.
struct NearLevels {
  LevelCells const* own;
  LevelCells const* coarser;
  LevelCells const* finer;
  Index3 ratio_below, ratio_above;  ///< cells of this level per coarser one, and of the finer one per cell of this
  NearPlaces own_places, coarse_places, fine_places;

  /// Look up those near the next box on the other levels: what its stencils read, and further parents; children where
  /// the finer level has any of its cells.
  ArrayOnBox<LocalIndex> add(Box const& box, StencilCells const& n, Box const& parents) {
    if (coarser) coarse_places.add(coarser->places(n.coarse_usable.box().empty() ? parents : n.coarse_usable.box()));
    Box children = n.children;  // those beside other boxes' refined cells included
    if (finer && children.empty() && finer->level().intersects(box.refine(ratio_above)))
      children = box.refine(ratio_above);
    auto fine = children.empty() ? ArrayOnBox<LocalIndex>(children, no_place) : finer->places(children);
    if (finer) fine_places.add(fine);
    return fine;
  }

  /// Look up those near the next box on the level itself, once its rows are named: fits in narrow gaps reach further
  /// than other stencils.
  void add_own(StencilCells const& n) { own_places.add(own->places(n.own_box())); }

  SparseMatrix to_own(FormTable const& forms, RowForms const& rows) const {
    return filled(forms, rows, own_places, {}, *own, *own);
  }
  SparseMatrix to_coarser(FormTable const& forms, RowForms const& rows) const {
    return filled(forms, rows, coarse_places, {{1, 1, 1}, ratio_below}, *own, *coarser);
  }
  SparseMatrix to_finer(FormTable const& forms, RowForms const& rows) const {
    return filled(forms, rows, fine_places, {ratio_above, {1, 1, 1}}, *own, *finer);
  }
};

}  // namespace amrpic
