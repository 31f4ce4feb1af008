#include "composite/composite_ghosts.hpp"

#include <algorithm>

namespace amrpic {

CompositeGhosts::CompositeGhosts(CompositeMesh& mesh) : mesh_(mesh), fluxes_(mesh) {
  for (int f = 0; f < 6; ++f) ghosts_[std::size_t(f)].resize(mesh_.largest_face(f / 2));
  std::size_t const row = mesh_.largest_row();
  coarse_.resize((row / 2 + 4) * (row / 2 + 4));
  star_.resize(2 * row);
}

void CompositeGhosts::visit(Field const& phi, std::vector<Walls> const& walls, std::vector<Real> const& potentials,
                            FullyCovered fully_covered, std::function<void(int, int)> const& f,
                            std::function<void(int)> const& done) {
  mesh_.plan().cells.start([&](int purpose, Read const& read, Real* out) {
    mesh_.pack_cells(phi, CompositePlan::level_of(purpose), read, out);
  });
  mesh_.visit(
      mesh_.plan().cells, fully_covered, [&](int l, int b) { return mesh_.plan(l, b).remote; },
      [&](int l) {
        if (mesh_.hierarchy().has_finer(l)) fluxes_.finish(l);
      },
      [&](int l, int b) {
        fill(l, b, phi, walls[std::size_t(l)], potentials);
        f(l, b);
      },
      [&](int l) {
        if (l > 0) fluxes_.send(l);
        if (done) done(l);
      });
  fluxes_.settle();
}

void CompositeGhosts::fill(int l, int b, Field const& phi, Walls const& walls, std::vector<Real> const& potentials) {
  for (int axis = 0; axis < 3; ++axis)
    for (int side = 0; side < 2; ++side) {
      int const f = 2 * axis + side;
      FacePlan const& face = mesh_.plan(l, b).faces[f];
      int const pitch = mesh_.box(l, b).extent(tangential_axes(axis)[0]);
      if (face.wall >= 0) {
        fill_wall(l, b, axis, side, phi.level(l).data() + mesh_.offset(l, b), walls.datum.data() + face.wall);
        continue;
      }
      for (int r = face.neighbours.first; r < face.neighbours.last; ++r)
        mesh_.plan(l).neighbours[r].copy(phi.level(l).data(), mesh_.plan().cells.values(), ghosts_[f].data(), pitch);
      if (face.interface < 0) continue;
      fill_interface(l, b, axis, side, phi);
      if (!mesh_.metal_faces(l, face.interface).empty()) fill_beside_metal(l, b, axis, side, phi, potentials);
    }
}

void CompositeGhosts::fill_wall(int l, int b, int axis, int side, Real const* phi, Real const* data) {
  WallGhost const ghost = wall_ghost(mesh_.hierarchy().domain().boundary[std::size_t(axis)][std::size_t(side)],
                                     mesh_.level(l).spacing()[axis]);
  Box const& own = mesh_.box(l, b);
  auto const [u, v] = tangential_axes(axis);
  Index3 const pitch = own.strides();
  std::ptrdiff_t const inward = side == 0 ? pitch[axis] : -pitch[axis];
  Real const* first = phi + (side == 0 ? 0 : std::ptrdiff_t(own.extent(axis) - 1) * pitch[axis]);
  Real* out = ghosts_[2 * axis + side].data();
  for (int y = 0; y < own.extent(v); ++y, first += pitch[v])
    for (int x = 0; x < own.extent(u); ++x) {
      Real const* cell = first + std::ptrdiff_t(x) * pitch[u];
      *out++ = ghost(cell[0], cell[inward], *data++);
    }
}

/// Ghosts in front of coarser cells, and what the four ghosts of each coarse face leave for the coarser cell behind it:
/// the sum of phi_1 - ghost, from which its outward derivative is a quarter of that over the fine spacing.
void CompositeGhosts::fill_interface(int l, int b, int axis, int side, Field const& phi) {
  int const f = 2 * axis + side;
  Interface const& i = mesh_.plan(l).interfaces[std::size_t(mesh_.plan(l, b).faces[f].interface)];
  std::ptrdiff_t const coarse_pitch = i.nu + 2 * i.margin;
  for (int r = i.coarse.first; r < i.coarse.last; ++r)
    mesh_.plan(l).coarse[r].copy(phi.level(l - 1).data(), mesh_.plan().cells.values(), coarse_.data(), coarse_pitch);

  Box const& own = mesh_.box(l, b);
  auto const [u, v] = tangential_axes(axis);
  FineSide const fine = fine_side(own, axis, side);
  Real const* const first = phi.level(l).data() + mesh_.offset(l, b) +
                            (side == 0 ? 0 : std::ptrdiff_t(own.extent(axis) - 1) * own.stride(axis)) +
                            2 * (i.u * own.stride(u) + i.v * own.stride(v));
  Real* const ghosts = ghosts_[f].data() + 2 * (i.u + std::ptrdiff_t(i.v) * own.extent(u));
  Real *const star = star_.data(), *const upper_star = star + 2 * i.nu;
  GapFit const* const* in_gap = nullptr;
  if (i.gaps >= 0) {
    Gaps const& gaps = mesh_.plan(l).gaps[std::size_t(i.gaps)];
    fill_gaps(l, gaps, phi);
    in_gap = &mesh_.plan(l).fits_in_gaps[std::size_t(gaps.fits)];
  }
  Index3 behind = own.coarsen(refinement_ratio).layer(axis, side, 1).lower;
  behind[u] += i.u, behind[v] += i.v;
  for (int row = 0; row < i.nv; ++row) {
    FitNumber const* fits = mesh_.plan(l).fits.data() + i.fits + std::ptrdiff_t(row) * i.nu;
    Real* flux = fluxes_.row(l, i, row);
    fit_row(fits, i.nu, coarse_.data() + i.margin + (i.margin + row) * coarse_pitch, coarse_pitch, star, upper_star);
    if (in_gap) {
      in_gap = fit_in_gaps(in_gap, fits, i.nu, u, behind, star, upper_star);
      ++behind[v];
    }
    Real const* const cells = first + 2 * std::ptrdiff_t(row) * fine.cell_v;
    Real* const ghost = ghosts + 2 * std::ptrdiff_t(row) * fine.ghost_v;
    for_each_run(fits, i.nu, [&](int start, int count, FitNumber) {
      for (int m = start; m < start + count; ++m) {
        FourStars<Real> const stars{{{star[2 * m], star[2 * m + 1]}, {upper_star[2 * m], upper_star[2 * m + 1]}}};
        flux[m] = fine.set_ghosts(stars, cells + 2 * m * fine.cell_u, ghost + 2 * m);
      }
    });
  }
}

/// The same for the faces that metal makes others, from the coarse values of the interface under way.
void CompositeGhosts::fill_beside_metal(int l, int b, int axis, int side, Field const& phi,
                                        std::vector<Real> const& potentials) {
  int const f = 2 * axis + side, number = mesh_.plan(l, b).faces[f].interface;
  Interface const& i = mesh_.plan(l).interfaces[std::size_t(number)];
  Box const& own = mesh_.box(l, b);
  auto const [u, v] = tangential_axes(axis);
  std::ptrdiff_t const coarse_pitch = i.nu + 2 * i.margin;
  FineSide const fine = fine_side(own, axis, side);
  Real const* const cells = phi.level(l).data() + mesh_.offset(l, b);
  Index3 const behind = own.coarsen(refinement_ratio).layer(axis, side, 1).lower;
  for (MetalFace const& face : mesh_.metal_faces(l, number)) {
    int const x = face.at.coarse[u] - behind[u] - i.u, y = face.at.coarse[v] - behind[v] - i.v;
    Real const* const coarse = coarse_.data() + i.margin + x + (i.margin + y) * coarse_pitch;
    FourStars<Real> stars{};
    for (auto const& term : face.cells) add_to_stars(stars, term.weight, coarse[term.i + term.j * coarse_pitch]);
    for (auto const& term : face.surfaces) add_to_stars(stars, term.weight, potentials[std::size_t(term.electrode)]);
    Index3 const cell = face.at.fine(0, 0);
    Real* const ghost = ghosts_[f].data() + place_on_face(own, axis, cell);
    fluxes_.row(l, i, y)[x] = GhostsBesideMetal(face).set(fine, stars, cells + own.offset(cell), ghost);
  }
}

/// phi* of the ghosts in gaps in front of a row of coarse cells from `cell` on, by the row's fits in gaps, of which the
/// first is at `in_gap`; the first one of the next row.
GapFit const* const* CompositeGhosts::fit_in_gaps(GapFit const* const* in_gap, FitNumber const* fits, int count, int u,
                                                  Index3 cell, Real* lower_row, Real* upper_row) const {
  for (int m = 0; m < count; ++m, ++cell[u]) {
    if (fits[m] != fit_in_gap) continue;
    FourStars<Real> stars{};
    for (auto const& term : (*in_gap)->terms)
      add_to_stars(stars, term.weight,
                   term.fine ? gap_values_(first_child_of(cell), term) : coarse_gap_values_(cell, term));
    std::copy_n(stars[0].data(), 2, lower_row + 2 * m), std::copy_n(stars[1].data(), 2, upper_row + 2 * m);
    ++in_gap;
  }
  return in_gap;
}

void CompositeGhosts::fill_gaps(int l, Gaps const& gaps, Field const& phi) {
  auto const fill = [&](GapValues<Real>& values, Box const& box, Range const& parts, Real const* own) {
    values.set_box(box);
    for (int p = parts.first; p < parts.last; ++p) {
      RegionPart const& part = mesh_.plan(l).region_parts[std::size_t(p)];
      values.copy_in(part.part, (part.here ? own : mesh_.plan().cells.values()) + part.from, part.pitch_y,
                     part.pitch_z);
    }
  };
  fill(coarse_gap_values_, gaps.coarse, gaps.coarse_parts, phi.level(l - 1).data());
  fill(gap_values_, gaps.coarse.refine(refinement_ratio), gaps.parts, phi.level(l).data());
}

std::size_t CompositeGhosts::bytes() const {
  std::size_t values = coarse_.capacity() + star_.capacity();
  for (auto const& face : ghosts_) values += face.capacity();
  return values * sizeof(Real) + fluxes_.bytes() + coarse_gap_values_.bytes() + gap_values_.bytes();
}

/// The value of phi beyond a side of a cell of the box under way, before finer cells or in a ghost.
Real CompositeGhosts::value_outside(int l, int b, Index3 const& cell, int side, Real phi) const {
  if (auto const difference = difference_beyond(l, b, cell, side)) return phi + *difference;
  return ghosts(side / 2, side % 2)[place_on_face(mesh_.box(l, b), side / 2, cell)];
}

/// The difference of phi across a side by the finer fluxes; none where no finer cells lie beyond.
std::optional<Real> CompositeGhosts::difference_beyond(int l, int b, Index3 const& cell, int side) const {
  RefinedSide const* const r = mesh_.finer_beyond(l, cell, side);
  if (!r) return {};
  return fine_face_weight * fluxes_.of(l, *r)[r->flux_at(counted_from_first(mesh_.box(l, b), cell))];
}

/// The datum of the wall beyond a side of a cell, which lies at one.
Real CompositeGhosts::wall_datum(int l, int b, Index3 const& cell, int side, std::vector<Walls> const& walls) const {
  std::ptrdiff_t const place = place_on_face(mesh_.box(l, b), side / 2, cell);
  return walls[std::size_t(l)].datum[std::size_t(mesh_.plan(l, b).faces[side].wall + place)];
}

ArmValues CompositeGhosts::line_through(int l, int b, CompositeMesh::CutHere const& here, int axis, Real const* phi,
                                        std::vector<Walls> const& walls, std::vector<Real> const& potentials) const {
  CutCell const& cut = here.cell;
  std::array<Real, 2> arm{1, 1}, value;
  for (std::size_t s = 0; s < 2; ++s) {
    std::size_t const side = 2 * std::size_t(axis) + s;
    bool const is_surface = here.row.surface(side) != 0, is_cut = is_surface && cut.is_cut(side);
    if (is_surface) arm[s] = is_cut ? cut.arm[side] : wall_arm;
    value[s] = is_cut       ? potentials[std::size_t(cut.electrode[side])]
               : is_surface ? wall_datum(l, b, cut.cell, int(side), walls)
                            : value_beyond(l, b, here, int(side), phi);
  }
  return {{arm[0], arm[1]}, value[0], value[1], *phi};
}

}  // namespace amrpic
