#include "operators/regular_rows.hpp"

#include "stencil/field_difference.hpp"
#include "stencil/laplacian.hpp"
#include "stencil/odd_extents.hpp"

namespace amrpic {

RowKinds kinds_without_finer(Level const& level, Box const& box, ArrayOnBox<GlobalIndex> const& numbers,
                             Real3 const& seam_width) {
  for (int d = 0; d < 3; ++d)  // both neighbours along a short period are the same cell
    if (level.periodic()[d] && level.domain().extent(d) <= 2) return RowKinds(box, RowKind::special);
  RowKinds kinds(box, RowKind::regular);
  for (int d = 0; d < 3; ++d)
    for (int side = 0; side < 2; ++side) {
      Box layer = box;
      (side == 0 ? layer.upper : layer.lower)[d] = (side == 0 ? box.lower : box.upper)[d];
      for_each_cell(layer, [&](Index3 const& cell) {
        Index3 outer = cell;
        outer[d] += side == 0 ? -1 : 1;
        if (numbers(outer) == no_cell) kinds(cell) = RowKind::special;
      });
    }
  for (int d = 0; d < 3; ++d) {
    if (seam_width[d] == 1) continue;
    int const n = level.domain().extent(d);
    for_each_cell(box, [&](Index3 const& cell) {
      if (seam_factor(cell[d], 0, n, seam_width[d]) != 1 || seam_factor(cell[d], 1, n, seam_width[d]) != 1)
        kinds(cell) = RowKind::special;
    });
  }
  return kinds;
}

RowKinds composite_kinds(RowKinds kinds, ArrayOnBox<char> const& covered) {
  auto const& values = covered.values();
  if (std::find(values.begin(), values.end(), 1) == values.end()) return kinds;
  Box const &box = kinds.box(), &wide = covered.box();
  std::ptrdiff_t const y = wide.extent(0), z = y * wide.extent(1);
  for (int k = box.lower[2]; k <= box.upper[2]; ++k)
    for (int j = box.lower[1]; j <= box.upper[1]; ++j) {
      char const* c = &covered({box.lower[0], j, k});
      RowKind* kind = &kinds({box.lower[0], j, k});
      for (int i = 0; i < box.extent(0); ++i, ++c) {
        if (c[-1] | c[1] | c[-y] | c[y] | c[-z] | c[z]) kind[i] = RowKind::beside;
        if (c[0]) kind[i] = RowKind::covered;
      }
    }
  return kinds;
}

void append_remote_neighbours(Level const& level, Box const& box, std::vector<GlobalIndex>& out) {
  for (int d = 0; d < 3; ++d)
    for (int side = 0; side < 2; ++side) {
      Box beside = box;
      beside.lower[d] = beside.upper[d] = side == 0 ? box.lower[d] - 1 : box.upper[d] + 1;
      append_remote(level, beside, out);
    }
}

RegularRows::RegularRows(Real3 const& spacing, Real shift, ArrayOnBox<LocalIndex> const& places)
    : places_(places),
      stride_{1, places.box().extent(0), std::ptrdiff_t(places.box().extent(0)) * places.box().extent(1)} {
  // unknown 0 is the cell, 1 + 2 axis + side its neighbours
  auto neighbour = [](int axis, int side) { return Row(1 + 2 * axis + side, 1); };
  Row const self(0, 1);
  Row const row = amrpic::laplacian(equation_on(spacing, shift), self, neighbour(0, 0), neighbour(0, 1),
                                    neighbour(1, 0), neighbour(1, 1), neighbour(2, 0), neighbour(2, 1));
  for (int k = 0; k < row.size(); ++k) laplacian_[std::size_t(row.column(k))] = row.value(k);
  for (int d = 0; d < 3; ++d) {
    Row const e = field_between(field_factor(spacing[d]), neighbour(d, 0), neighbour(d, 1));
    gradient_[d] = {e.value(0), e.value(1)};
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
