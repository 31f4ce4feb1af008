#include "matrixfree/composite_mesh.hpp"

#include <algorithm>

namespace amrpic {

CompositeMesh::CompositeMesh(std::shared_ptr<Hierarchy const> hierarchy, Real shift, Real3 const& stretch)
    : hierarchy_(std::move(hierarchy)), shift_(shift), stretch_(stretch), plan_(*hierarchy_), transfer_(hierarchy_) {
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

void CompositeMesh::pack_cells(Field const& field, int l, Read const& read, Real* out) const {
  Box const &own = level(l).box(read.owner), part = read.cells();
  Real const* from = field.level(l).data() + level(l).local_offset(read.owner);
  for_each_row(part, [&](Index3 const& first) { out = std::copy_n(from + own.offset(first), part.extent(0), out); });
}

}  // namespace amrpic
