#include "matrices/row_kinds.hpp"

#include <algorithm>

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

}  // namespace amrpic
