#include "matrixfree/composite_mesh.hpp"

#include <algorithm>

namespace amrpic {

CompositeMesh::CompositeMesh(std::shared_ptr<Hierarchy const> hierarchy, Real shift, Real3 const& stretch)
    : hierarchy_(std::move(hierarchy)), shift_(shift), stretch_(stretch), plan_(*hierarchy_) {
  for_each_box([&](int l, int b) {
    for (int d = 0; d < 3; ++d) {
      auto const [u, v] = tangential_axes(d);
      std::size_t const face = std::size_t(box(l, b).extent(u)) * std::size_t(box(l, b).extent(v));
      largest_face_[d] = std::max(largest_face_[d], face);
      largest_row_ = std::max(largest_row_, std::size_t(box(l, b).extent(d)));
    }
  });
}

void CompositeMesh::clear_covered(int l, int b, int k, Real* plane) const {
  for_each_covered_row(l, b, k, [&](std::ptrdiff_t at, int n) { std::fill_n(plane + at, n, 0.0); });
}

Real* CompositeMesh::pack_cells(Field const& field, Piece const& piece, Real* out) const {
  Box const& own = level(piece.level).box(piece.box);
  Real const* from = field.level(piece.level).data() + level(piece.level).local_offset(piece.box);
  for (int k = piece.part.lower[2]; k <= piece.part.upper[2]; ++k)
    for (int j = piece.part.lower[1]; j <= piece.part.upper[1]; ++j)
      out = std::copy_n(from + own.offset({piece.part.lower[0], j, k}), piece.part.extent(0), out);
  return out;
}

}  // namespace amrpic
