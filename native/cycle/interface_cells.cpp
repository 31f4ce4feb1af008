#include "cycle/interface_cells.hpp"

#include <algorithm>

#include "mesh/hierarchy.hpp"

namespace amrpic::cycle {

namespace {

constexpr int margin = 2;  ///< of coarser cells that fits take, around the parents

}  // namespace

InterfaceCells::InterfaceCells(Level const& level, Level const& coarser, Level const* finer, Layout const& layout,
                               LevelFaces const& faces, std::vector<CoarsePatch> const& patches, Stencil const& stencil,
                               std::array<float, 3> const& coarse_weight, std::shared_ptr<GapFits> gap_fits,
                               MetalBeside const& metal)
    : gap_fits_(std::move(gap_fits)) {
  std::array<float, 3> const& weight = stencil.weight();
  std::optional<LevelsInMetal> in_metal;
  MetalCells coarse_rows;
  if (metal.metal) {
    std::vector<Box> own, around;
    for (std::size_t b = 0; b < layout.own_blocks(); ++b) {
      own.push_back(layout.blocks()[b].box.grow(1));
      around.push_back(patches[b].box.grow(1));
    }
    in_metal.emplace(coarser, level, metal.metal->cells(coarser, around), metal.metal->cells(level, own));
    coarse_rows = metal_of_level(*metal.metal, coarser, metal.coarsest, {&level}, around, false).cells;
  }
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
        auto fits = fits_behind(beyond, axis, near, refined);
        Box const& parents = fits.box();
        InterfaceSide face;
        face.nu = parents.extent(u);
        face.nv = parents.extent(v);
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
        if (in_metal) add_metal(face, parents, b, block, *in_metal, stencil, coarse_rows, metal.coarse_equation, fits);
        face.fits = fits_.size();
        fits_.insert(fits_.end(), fits.values().begin(), fits.values().end());
        add_gaps(face, fits, near, refined, level, finer, layout);
        faces_.push_back(face);
        plane_.resize(std::max(plane_.size(), std::size_t(face.nu + 2 * margin) * std::size_t(face.nv + 2 * margin)));
        rows_.resize(std::max(rows_.size(), std::size_t(4 * face.nu)));
      }
  }
}

/// The faces behind a side of a block that metal makes others, which have no fits then. `coarse_rows`: arms of the
/// coarser level as its equations have them.
void InterfaceCells::add_metal(InterfaceSide const& face, Box const& parents, std::size_t block, CellBlock const& cells,
                               LevelsInMetal const& levels, Stencil const& stencil, MetalCells const& coarse_rows,
                               Equation const& coarse_equation, ArrayOnBox<FitNumber>& fits) {
  auto const [u, v] = tangential_axes(face.axis);
  for_each_cell(parents, [&](Index3 const& cell) {
    if (fits(cell) == no_fit) return;
    auto const beside = levels.beside_metal({cell, face.axis, face.side}, fits(cell));
    if (!beside) return;
    fits(cell) = no_fit;
    if (beside->links == 0) return;
    int const x = cell[u] - parents.lower[u], y = cell[v] - parents.lower[v];
    MetalSide out{
        {std::int32_t(first_cell(face, x, y)), std::int32_t(face.parent + x * face.parent_u + y * face.parent_v),
         face.cell_u, face.cell_v, face.inward},
        2 * face.axis + face.side,
        {}};
    CutCell const* const cut = coarse_rows.cut_at(levels.wrapped(cell));
    std::size_t const toward = beside->at.inward();
    Real coarse = coarse_equation.weight[face.axis];
    if (cut) {
      std::array<Arm, 6> arms;
      for (std::size_t n = 0; n < 6; ++n) arms[n] = arm_of(*cut, n);
      coarse = cut_row(coarse_equation, arms, cut->hold).neighbour(toward);
    }
    coarse *= fine_face_weight * beside->of_links();
    for (std::size_t b = 0; b < 2; ++b)
      for (std::size_t a = 0; a < 2; ++a) {
        if (!beside->linked[b][a]) continue;
        Index3 at = beside->at.fine(int(a), int(b));
        for (int d = 0; d < 3; ++d) at[d] -= cells.box.lower[d];
        float const own = stencil.weight_beyond(block, cells.box.extent(1), at, beside->at.outward());
        out.star[b][a] = own * float(beside->star(a, b));
        out.first[b][a] = float(coarse * (1 - beside->first(a, b)));
        out.second[b][a] = float(-coarse * beside->second(a, b));
      }
    for (auto const& term : beside->cells)
      out.terms.push_back({out.parent + term.i * face.parent_u + term.j * face.parent_v, term.weight});
    metal_.push_back(std::move(out));
  });
}

/// The fits in gaps behind a face. `near`, `refined`: parts of the coarser level and of this one around it.
void InterfaceCells::add_gaps(InterfaceSide& face, ArrayOnBox<FitNumber> const& fits, std::vector<Overlap> const& near,
                              std::vector<Overlap> const& refined, Level const& level, Level const* finer,
                              Layout const& layout) {
  face.first_gap = gaps_.size(), face.first_part = parts_.size();
  Box const gaps = hull_of_fits(fits, [](FitNumber fit) { return fit == fit_in_gap; });
  if (!gaps.empty()) {
    face.first_child = first_child_of(fits.box().lower);
    face.region = gaps.grow(1).refine(refinement_ratio);
    GapCells const cells(level, gaps.grow(1), near, refined, finer);
    for_each_cell(fits.box(), [&](Index3 const& cell) {
      if (fits(cell) == fit_in_gap) gaps_.push_back(&(*gap_fits_)(cells.around(cell), face.axis));
    });
    if (gap_fits_take_fine_cells(level))
      layout.for_each_overlap(face.region, [&](CellBlock const& block, Box const& part, Index3 const& shift) {
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
    gap_values_.set_box(face.region);
    for (std::size_t p = face.first_part; p < face.first_part + face.parts; ++p) {
      auto const& [part, from] = parts_[p];
      gap_values_.copy_in(part, &e[std::size_t(from.origin)], from.pitch_y, from.pitch_z);
    }
    auto const [axis_u, axis_v] = tangential_axes(face.axis);
    for_each_gap(face, [&](std::size_t gap, int u, int v) {
      Index3 child = face.first_child;
      child[axis_u] += 2 * u, child[axis_v] += 2 * v;
      FourStars<float> stars{};
      for (auto const& term : gaps_[gap]->terms)
        if (term.fine) add_to_stars(stars, term.weight, gap_values_(child, term));
      face.change_ghosts(stars, taken_[gap], &r[first_cell(face, u, v)]);
    });
  }
}

void InterfaceCells::subtract_coarse(Vector const& coarse_values, Vector& r) const {
  for (MetalSide const& side : metal_) {
    FourStars<float> stars{};
    for (auto const& [place, weight] : side.terms) add_to_stars(stars, weight, coarse_values[std::size_t(place)]);
    side.subtract_ghosts(stars, r.data());
  }
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
  for (MetalSide const& side : metal_) coarse_values[std::size_t(side.parent)] -= side.flux(e.data());
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
  std::size_t terms = 0;
  for (MetalSide const& side : metal_) terms += side.terms.size() * sizeof side.terms[0];
  return faces_.size() * sizeof(InterfaceSide) + fits_.size() + gap_values_.bytes() +
         metal_.size() * sizeof(MetalSide) + terms + gaps_.size() * (sizeof(GapFit const*) + sizeof taken_[0]) +
         parts_.size() * sizeof(RegionPart) + (plane_.size() + rows_.size()) * sizeof(float);
}

}  // namespace amrpic::cycle
