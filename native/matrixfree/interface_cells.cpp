#include "matrixfree/interface_cells.hpp"

#include <algorithm>

namespace amrpic::matrixfree {

namespace {

constexpr int margin = 2;  ///< of coarser cells that fits take, around the parents

}  // namespace

InterfaceCells::InterfaceCells(Level const& level, Level const& coarser, Layout const& layout, LevelFaces const& faces,
                               std::vector<CoarsePatch> const& patches, std::array<float, 3> const& weight,
                               std::array<float, 3> const& coarse_weight) {
  for (std::size_t b = 0; b < layout.own_blocks(); ++b) {
    if (!faces[b].ends_level()) continue;
    CellBlock const& block = layout.blocks()[b];
    CoarsePatch const& patch = patches[b];
    auto const near = overlaps(coarser, patch.box), refined = overlaps(level, patch.box.refine({2, 2, 2}));
    for (int axis = 0; axis < 3; ++axis)
      for (int side = 0; side < 2; ++side) {
        Face const& beyond = faces[b].sides[std::size_t(2 * axis + side)];
        if (!beyond.has_coarser) continue;
        auto const [u, v] = tangential_axes(axis);
        auto const fits = fits_behind(beyond, axis, near, refined);
        Box const& parents = fits.box();
        InterfaceSide face;
        face.nu = parents.extent(u);
        face.nv = parents.extent(v);
        face.fits = fits_.size();
        fits_.insert(fits_.end(), fits.values().begin(), fits.values().end());
        Index3 first = beyond.layer.lower;
        first[axis] += side == 0 ? 1 : -1;
        face.cell = block.place(first);
        face.cell_u = block.cells.stride(u);
        face.cell_v = block.cells.stride(v);
        face.inward = block.cells.stride(axis) * (side == 0 ? 1 : -1);
        face.parent = patch.place(parents.lower);
        face.parent_u = patch.cells.stride(u);
        face.parent_v = patch.cells.stride(v);
        face.weight = float(weight[axis] * interface_ghost::coarse);
        face.flux_weight = float(fine_face_weight) * coarse_weight[axis];
        faces_.push_back(face);
        plane_.resize(std::max(plane_.size(), std::size_t(face.nu + 2 * margin) * std::size_t(face.nv + 2 * margin)));
        rows_.resize(std::max(rows_.size(), std::size_t(4 * face.nu)));
      }
  }
}

void InterfaceCells::subtract_coarse(Vector const& coarse_values, Vector& r) const {
  for (InterfaceSide const& face : faces_) {
    float const* coarse = &coarse_values[std::size_t(face.parent)];
    std::ptrdiff_t pitch = face.parent_v;
    if (face.parent_u != 1) {  // rows of their own, for what follows
      pitch = face.nu + 2 * margin;
      float* to = plane_.data();
      for (int v = -margin; v < face.nv + margin; ++v)
        for (int u = -margin; u < face.nu + margin; ++u) *to++ = coarse[u * face.parent_u + v * face.parent_v];
      coarse = plane_.data() + margin + margin * pitch;
    }
    for (int v = 0; v < face.nv; ++v) {
      FitNumber const* const fits = &fits_[face.fits + std::size_t(v) * std::size_t(face.nu)];
      fit_row(fits, face.nu, coarse + v * pitch, pitch, rows_.data(), rows_.data() + 2 * face.nu);
      for_each_run(fits, face.nu, [&](int u, int count, FitNumber) {
        for (int half = 0; half < 2; ++half) {
          float const* const ghost = rows_.data() + 2 * face.nu * half;
          float* const cell = &r[std::size_t(face.cell + (2 * v + half) * face.cell_v)];
          if (face.cell_u == 1)
            for (int i = 2 * u; i < 2 * (u + count); ++i) cell[i] -= face.weight * ghost[i];
          else
            for (int i = 2 * u; i < 2 * (u + count); ++i) cell[i * face.cell_u] -= face.weight * ghost[i];
        }
      });
    }
  }
}

void InterfaceCells::subtract_flux(Vector const& e, Vector& coarse_values) const {
  for (InterfaceSide const& face : faces_) {
    auto through = [&](float const* cell) { return difference_at_interface(cell[0], cell[face.inward]); };
    for (int v = 0; v < face.nv; ++v)
      for_each_run(
          &fits_[face.fits + std::size_t(v) * std::size_t(face.nu)], face.nu, [&](int u, int count, FitNumber) {
            float const* cell = &e[std::size_t(face.cell + 2 * v * face.cell_v + 2 * u * face.cell_u)];
            float* parent = &coarse_values[std::size_t(face.parent + v * face.parent_v + u * face.parent_u)];
            for (int i = 0; i < count; ++i, cell += 2 * face.cell_u, parent += face.parent_u)
              *parent -= face.flux_weight * (through(cell) + through(cell + face.cell_u) + through(cell + face.cell_v) +
                                             through(cell + face.cell_u + face.cell_v));
          });
  }
}

std::size_t InterfaceCells::bytes() const {
  return faces_.size() * sizeof(InterfaceSide) + fits_.size() + (plane_.size() + rows_.size()) * sizeof(float);
}

}  // namespace amrpic::matrixfree
