#include "matrixfree/interface_cells.hpp"

#include <algorithm>

#include "mesh/hierarchy.hpp"

namespace amrpic::matrixfree {

namespace {

constexpr int margin = 2;  ///< of coarser cells that fits take, around the parents

}  // namespace

InterfaceCells::InterfaceCells(Level const& level, Level const& coarser, Level const* finer, Layout const& layout,
                               LevelFaces const& faces, std::vector<CoarsePatch> const& patches,
                               std::array<float, 3> const& weight, std::array<float, 3> const& coarse_weight,
                               std::shared_ptr<GapFits> gap_fits)
    : gap_fits_(std::move(gap_fits)) {
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
        face.cell_u = std::int32_t(block.cells.stride(u));
        face.cell_v = std::int32_t(block.cells.stride(v));
        face.inward = std::int32_t(block.cells.stride(axis) * (side == 0 ? 1 : -1));
        face.parent = patch.place(parents.lower);
        face.parent_u = std::int32_t(patch.cells.stride(u));
        face.parent_v = std::int32_t(patch.cells.stride(v));
        face.weight = float(weight[axis] * interface_ghost::coarse);
        face.flux_weight = float(fine_face_weight) * coarse_weight[axis];
        face.axis = axis, face.side = side;
        face.parent_normal = patch.cells.stride(axis);
        add_gaps(face, fits, near, refined, level, finer, layout);
        faces_.push_back(face);
        plane_.resize(std::max(plane_.size(), std::size_t(face.nu + 2 * margin) * std::size_t(face.nv + 2 * margin)));
        rows_.resize(std::max(rows_.size(), std::size_t(4 * face.nu)));
      }
  }
}

/// The fits in gaps behind a face. `near`, `refined`: parts of the coarser level and of this one around it.
void InterfaceCells::add_gaps(InterfaceSide& face, ArrayOnBox<FitNumber> const& fits, std::vector<Overlap> const& near,
                              std::vector<Overlap> const& refined, Level const& level, Level const* finer,
                              Layout const& layout) {
  face.first_gap = gaps_.size(), face.first_part = parts_.size();
  Box const gaps = hull_of_fits(fits, [](FitNumber fit) { return fit == fit_in_gap; });
  if (!gaps.empty()) {
    face.first_child = first_child_of(fits.box().lower);
    face.window = gaps.grow(1).refine(refinement_ratio);
    GapCells const cells(level, gaps.grow(1), near, refined, finer);
    for_each_cell(fits.box(), [&](Index3 const& cell) {
      if (fits(cell) == fit_in_gap) gaps_.push_back(&(*gap_fits_)(cells.around(cell), face.axis));
    });
    if (gap_fits_take_fine_cells(level))
      layout.for_each_overlap(face.window, [&](CellBlock const& block, Box const& part, Index3 const& shift) {
        Placement from = block.cells;
        from.origin = block.place(part.shift_back(shift).lower);
        parts_.push_back({part, from});
      });
  }
  face.gaps = gaps_.size() - face.first_gap, face.parts = parts_.size() - face.first_part;
  taken_.resize(gaps_.size());
}

/// Call f(number of the gap, place of its coarse cell along u, along v).
template <class F>
void InterfaceCells::for_each_gap(InterfaceSide const& face, F&& f) const {
  if (face.gaps == 0) return;
  std::size_t gap = face.first_gap;
  for (int v = 0; v < face.nv; ++v)
    for (int u = 0; u < face.nu; ++u)
      if (fits_[face.fits + std::size_t(u + v * face.nu)] == fit_in_gap) f(gap++, u, v);
}

void InterfaceCells::subtract_in_gaps(Vector const& e, Vector& r) {
  for (InterfaceSide const& face : faces_) {
    if (face.gaps == 0) continue;
    window_.set_box(face.window);
    for (std::size_t p = face.first_part; p < face.first_part + face.parts; ++p) {
      auto const& [part, from] = parts_[p];
      window_.copy_in(part, &e[std::size_t(from.origin)], from.pitch_y, from.pitch_z);
    }
    auto const [axis_u, axis_v] = tangential_axes(face.axis);
    for_each_gap(face, [&](std::size_t gap, int u, int v) {
      Index3 child = face.first_child;
      child[axis_u] += 2 * u, child[axis_v] += 2 * v;
      FourStars<float> stars{};
      for (auto const& term : gaps_[gap]->terms)
        if (term.fine) add_to_stars(stars, term.weight, window_(child, term));
      face.change_ghosts(stars, taken_[gap], &r[first_cell(face, u, v)]);
    });
  }
}

void InterfaceCells::subtract_coarse(Vector const& coarse_values, Vector& r) const {
  for (InterfaceSide const& face : faces_) {
    float const* coarse = &coarse_values[std::size_t(face.parent)];
    std::array<std::ptrdiff_t, 3> step{};
    auto const [axis_u, axis_v] = tangential_axes(face.axis);
    step[std::size_t(axis_u)] = face.parent_u, step[std::size_t(axis_v)] = face.parent_v;
    step[std::size_t(face.axis)] = face.parent_normal;
    for_each_gap(face, [&](std::size_t gap, int u, int v) {
      FourStars<float> stars{};
      float const* const middle = coarse + u * face.parent_u + v * face.parent_v;
      for (auto const& term : gaps_[gap]->terms)
        if (!term.fine)
          add_to_stars(stars, term.weight,
                       middle[term.offset[0] * step[0] + term.offset[1] * step[1] + term.offset[2] * step[2]]);
      face.subtract_ghosts(stars, &r[first_cell(face, u, v)]);
    });
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
      for_each_run(fits, face.nu, [&](int u, int count, FitNumber fit) {
        if (fit == fit_in_gap) return;
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
    for (int v = 0; v < face.nv; ++v)
      for_each_run(&fits_[face.fits + std::size_t(v) * std::size_t(face.nu)], face.nu,
                   [&](int u, int count, FitNumber) {
                     float const* cell = &e[first_cell(face, u, v)];
                     float* parent = &coarse_values[std::size_t(face.parent + v * face.parent_v + u * face.parent_u)];
                     for (int i = 0; i < count; ++i, cell += 2 * face.cell_u, parent += face.parent_u)
                       *parent -= face.flux(cell);
                   });
    for_each_gap(face, [&](std::size_t gap, int u, int v) {
      coarse_values[std::size_t(face.parent + u * face.parent_u + v * face.parent_v)] +=
          face.flux_of_ghosts(taken_[gap]);
    });
  }
}

std::size_t InterfaceCells::bytes() const {
  return faces_.size() * sizeof(InterfaceSide) + fits_.size() + window_.bytes() +
         gaps_.size() * (sizeof(GapFit const*) + sizeof taken_[0]) + parts_.size() * sizeof(WindowPart) +
         (plane_.size() + rows_.size()) * sizeof(float);
}

}  // namespace amrpic::matrixfree
