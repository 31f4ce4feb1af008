#include "matrixfree/composite_mesh.hpp"

#include <algorithm>

namespace amrpic {

CompositeMesh::CompositeMesh(std::shared_ptr<Hierarchy const> hierarchy, Real shift, Real3 const& stretch,
                             Metal const* metal)
    : hierarchy_(std::move(hierarchy)),
      shift_(shift),
      stretch_(stretch),
      plan_(*hierarchy_),
      transfer_(hierarchy_),
      metal_(metal),
      metal_cells_(std::size_t(levels())),
      cut_rows_(std::size_t(levels())) {
  for (int l = 0; metal && l < levels(); ++l) add_metal(l);
  for_each_box([&](int l, int b) {
    for (int d = 0; d < 3; ++d) {
      auto const [u, v] = tangential_axes(d);
      std::size_t const face = std::size_t(box(l, b).extent(u)) * std::size_t(box(l, b).extent(v));
      largest_face_[d] = std::max(largest_face_[d], face);
      largest_row_ = std::max(largest_row_, std::size_t(box(l, b).extent(d)));
    }
  });
}

void CompositeMesh::add_metal(int l) {
  MetalCells& cells = metal_cells_[std::size_t(l)];
  cells = metal_->own_cells(level(l));
  for (CutCell const& cut : cells.cut()) {
    std::array<Arm, 6> arms;
    for (std::size_t n = 0; n < 6; ++n) {
      int const axis = int(n) / 2, side = int(n) % 2;
      Box const& domain = level(l).domain();
      bool const wall = !level(l).periodic()[axis] && cut.cell[axis] == (side == 0 ? domain.lower : domain.upper)[axis];
      arms[n] = arm_of(cut, n, wall);
      arms[n].is_parabola = wall && hierarchy_->domain().boundary[axis][side] == Boundary::dirichlet;
    }
    cut_rows_[std::size_t(l)].push_back(cut_row(equation(l), arms));
  }
}

void CompositeMesh::clear_covered(int l, int b, int k, Real* plane) const {
  for_each_covered_row(l, b, k, [&](std::ptrdiff_t at, int n) { std::fill_n(plane + at, n, 0.0); });
}

bool CompositeMesh::is_covered(int l, int b, Index3 const& cell) const {
  Index3 const& lower = box(l, b).lower;
  Index3 const at{cell[0] - lower[0], cell[1] - lower[1], cell[2] - lower[2]};
  for (int c = plan(l, b).covered.first; c < plan(l, b).covered.last; ++c)
    if (plan(l).covered[std::size_t(c)].contains(at)) return true;
  return false;
}

void CompositeMesh::pack_cells(Field const& field, int l, Read const& read, Real* out) const {
  Box const &own = level(l).box(read.owner), part = read.cells();
  Real const* from = field.level(l).data() + level(l).local_offset(read.owner);
  for_each_row(part, [&](Index3 const& first) { out = std::copy_n(from + own.offset(first), part.extent(0), out); });
}

}  // namespace amrpic
