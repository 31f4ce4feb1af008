#include "operators/regular_rows.hpp"

#include <algorithm>

#include "stencil/field_difference.hpp"
#include "stencil/laplacian.hpp"

namespace amrpic {

RowKinds row_kinds(StencilCells const& cells, Execution execution) {
  bool const composite = execution == Execution::composite;
  auto kind_of = [composite](CellFaces const& faces) {
    RowKind const own = faces.any_wall_or_coarser() ? RowKind::special : RowKind::regular;
    RowKind const kind = composite && faces.any_finer() ? RowKind::beside : own;
    return composite && faces.is_covered() ? RowKind::covered : kind;
  };
  Box const& box = cells.faces.box();
  RowKinds kinds(box, RowKind::regular);
  std::transform(cells.faces.values().begin(), cells.faces.values().end(), kinds.values().begin(), kind_of);
  auto set_special = [&](Box const& part) {
    for_each_cell(part.intersect(box), [&](Index3 const& cell) {
      if (kinds(cell) == RowKind::regular) kinds(cell) = RowKind::special;
    });
  };
  for (int d = 0; d < 3; ++d) {
    int const n = cells.level->domain().extent(d);
    Real const width = cells.seam_width[d];
    if (cells.level->periodic()[d] && n <= 2) set_special(box);  // both neighbours are the same cell
    if (width == 1) continue;
    Box layer = box;
    for (int i = box.lower[d]; i <= box.upper[d]; ++i) {
      layer.lower[d] = layer.upper[d] = i;
      if (seam_factor(i, 0, n, width) != 1 || seam_factor(i, 1, n, width) != 1) set_special(layer);
    }
  }
  return kinds;
}

RegularRows::RegularRows(Real3 const& spacing, Real shift, ArrayOnBox<LocalIndex> const& places)
    : places_(places), stride_{places.box().stride(0), places.box().stride(1), places.box().stride(2)} {
  // unknown 0 is the cell, 1 + 2 axis + side its neighbours
  auto neighbour = [](int axis, int side) { return Row(1 + 2 * axis + side, 1); };
  Row const self(0, 1);
  Row const row = amrpic::laplacian(equation_on(spacing, shift), self, neighbour(0, 0), neighbour(0, 1),
                                    neighbour(1, 0), neighbour(1, 1), neighbour(2, 0), neighbour(2, 1));
  for (auto const& [unknown, weight] : row.terms()) laplacian_[std::size_t(unknown)] = weight;
  for (int d = 0; d < 3; ++d) {
    Row const e = field_between(field_factor(spacing[d]), neighbour(d, 0), neighbour(d, 1));
    gradient_[d] = {e.terms()[0].value, e.terms()[1].value};
  }
}

void RegularRows::laplacian(Index3 const& first, LocalIndex rows, LocalIndex* column, Real* value) const {
  LocalIndex const* place = &places_(first);
  auto const [x, y, z] = stride_;
  repeat(laplacian_.data(), laplacian_terms, rows, value);
  for (LocalIndex n = 0; n < rows; ++n, ++place, column += laplacian_terms) {
    column[0] = place[0];
    column[1] = place[-x], column[2] = place[x];
    column[3] = place[-y], column[4] = place[y];
    column[5] = place[-z], column[6] = place[z];
  }
}

void RegularRows::gradient(int axis, Index3 const& first, LocalIndex rows, LocalIndex* column, Real* value) const {
  LocalIndex const* place = &places_(first);
  std::ptrdiff_t const step = stride_[axis];
  repeat(gradient_[axis].data(), gradient_terms, rows, value);
  for (LocalIndex n = 0; n < rows; ++n) column[2 * n] = place[n - step], column[2 * n + 1] = place[n + step];
}

}  // namespace amrpic
