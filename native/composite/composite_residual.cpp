#include "composite/composite_residual.hpp"

#include <algorithm>
#include <cmath>

#include "base/constants.hpp"
#include "composite/composite_kernels.hpp"
#include "stencil/laplacian.hpp"
#include "stencil/wall_ghost.hpp"

namespace amrpic {

namespace {

/// Arm below which what is left of a cell's equation gives the flux through it. The difference over the arm has the
/// error of phi times the inverse of it: after two cycles the charge on a foil with arms of 0.01 was five times too
/// large, and open faces, which see it, did not settle.
constexpr Real short_arm = wall_arm / 2;

/// Call f(place in the plane, u, v, extent along u) for the cells of plane k of a box that lie at one of its faces.
template <class F>
void for_each_on_face(Box const& box, int face, int k, F&& f) {
  int const axis = face / 2, layer = face % 2 == 0 ? 0 : box.extent(axis) - 1;
  std::ptrdiff_t const nx = box.extent(0);
  if (axis == 0)
    for (int j = 0; j < box.extent(1); ++j) f(layer + j * nx, j, k, box.extent(1));
  if (axis == 1)
    for (int i = 0; i < nx; ++i) f(i + layer * nx, i, k, int(nx));
  if (axis == 2 && k == layer)
    for (int j = 0; j < box.extent(1); ++j)
      for (int i = 0; i < nx; ++i) f(i + j * nx, i, j, int(nx));
}

}  // namespace

/// f - L phi of a plane of cells, into `plane_`; zero in covered ones.
void SecondOrderResidual::residual_plane(int l, int b, int k, Source const& source, Field const& phi) {
  Box const& own = mesh_.box(l, b);
  int const nx = own.extent(0), ny = own.extent(1), nz = own.extent(2);
  std::ptrdiff_t const plane = std::ptrdiff_t(nx) * ny;
  auto const& values = phi.level(l);
  Real const* const cells = values.data() + mesh_.offset(l, b);
  Real const* const rho = source.rho.level(l).data() + mesh_.offset(l, b) + k * plane;
  kernels::Residual const formula{mesh_.equation(l), source.background, mesh_.is_nearly_free(l)};
  Real const* const c = cells + k * plane;
  Real const* const below = k > 0 ? c - plane : ghosts_.ghosts(2, 0);
  Real const* const above = k + 1 < nz ? c + plane : ghosts_.ghosts(2, 1);
  auto neighbours = [&](int j) {
    std::ptrdiff_t const at = std::ptrdiff_t(j) * nx;
    return kernels::Neighbours{j > 0 ? c + at - nx : ghosts_.ghosts(1, 0) + std::ptrdiff_t(k) * nx,
                               j + 1 < ny ? c + at + nx : ghosts_.ghosts(1, 1) + std::ptrdiff_t(k) * nx, below + at,
                               above + at};
  };
  // Rows between the first and the last lie side by side, as their neighbours do. Only memory of the level is read.
  Real const *const level_begin = values.data(), *const level_end = level_begin + values.size();
  auto sweep = [&](int first, int last) {
    std::ptrdiff_t const at = std::ptrdiff_t(first) * nx, cells_here = std::ptrdiff_t(last - first) * nx;
    bool const starts = c + at == level_begin, ends = c + at + cells_here == level_end;
    kernels::residual_run(formula, starts ? 1 : 0, cells_here - (ends ? 1 : 0), c + at, neighbours(first), rho + at,
                          plane_.data() + at);
  };
  sweep(0, 1);
  sweep(1, ny - 1);
  sweep(ny - 1, ny);
  for (int j = 0; j < ny; ++j) {
    std::ptrdiff_t const at = std::ptrdiff_t(j) * nx;
    std::size_t const end = std::size_t(j) + std::size_t(k) * std::size_t(ny);
    kernels::residual_ends(formula, nx, c + at, neighbours(j), ghosts_.ghosts(0, 0)[end], ghosts_.ghosts(0, 1)[end],
                           rho + at, plane_.data() + at);
  }
  ghosts_.for_each_refined(l, b, k, cells, [&](std::ptrdiff_t at, int axis, int, Real excess) {
    plane_[std::size_t(at - k * plane)] -= formula.equation.weight[axis] * excess;
  });
  if (mesh_.metal()) residual_beside_metal(l, b, k, source, cells);
  mesh_.clear_covered(l, b, k, plane_.data());
}

/// The same beside metal, and zero in it. Kept apart from the loops over planes.
void SecondOrderResidual::residual_beside_metal(int l, int b, int k, Source const& source, Real const* cells) {
  std::ptrdiff_t const plane = mesh_.box(l, b).stride(2);
  Real const *const c = cells + k * plane, *const rho = source.rho.level(l).data() + mesh_.offset(l, b) + k * plane;
  std::ptrdiff_t const pitch = mesh_.box(l, b).stride(1);
  std::array<std::ptrdiff_t, 6> const step{-1, 1, -pitch, pitch, -plane, plane};
  mesh_.for_each_in_metal(
      l, b, k, Covered::skip,
      [&](CompositeMesh::CutHere const& here) {
        CutRow const& row = here.row;
        std::ptrdiff_t const at = here.place;
        Real sum = -row.diagonal * c[at];
        if (here.is_inside())
          for (std::size_t side = 0; side < 6; ++side) sum += row.neighbour(side) * c[at + step[side]];
        else
          for (std::size_t side = 0; side < 6; ++side)
            if (!row.has_surface(side)) sum += row.factor[side] * ghosts_.value_beyond(l, b, here, int(side), c + at);
        plane_[std::size_t(at)] =
            row.scale * source.background.right_hand_side(rho[at]) - sum - of_surfaces(l, b, here, source);
      },
      [&](std::ptrdiff_t at, int n, int) { std::fill_n(&plane_[std::size_t(at)], n, 0.0); });
}

void SecondOrderResidual::right_hand_side_beside_metal(int l, int b, int k, Source const& source) {
  Real const* const rho = source.rho.level(l).data() + mesh_.offset(l, b) + k * mesh_.box(l, b).stride(2);
  mesh_.for_each_in_metal(
      l, b, k, Covered::skip,
      [&](CompositeMesh::CutHere const& here) {
        plane_[std::size_t(here.place)] =
            here.row.scale * source.background.right_hand_side(rho[here.place]) - of_data(l, b, here, source);
      },
      [&](std::ptrdiff_t at, int n, int) { std::fill_n(&plane_[std::size_t(at)], n, 0.0); });
}

/// What the potentials of the surfaces beside a cut cell add to its Laplacian.
Real SecondOrderResidual::of_several_surfaces(int l, int b, CompositeMesh::CutHere const& here,
                                              Source const& source) const {
  auto const& [cut, row, at, place, inside, electrode] = here;
  Real out = 0;
  for (std::size_t side = 0; side < 6; ++side)
    if (row.surface(side) != 0)
      out += row.surface(side) * (cut.is_cut(side) ? source.potentials[std::size_t(cut.electrode[side])]
                                                   : ghosts_.wall_datum(l, b, cut.cell, int(side), source.walls));
  return out;
}

/// The same, and what walls add whose ghosts take part in it.
Real SecondOrderResidual::of_data(int l, int b, CompositeMesh::CutHere const& here, Source const& source) const {
  Real out = of_surfaces(l, b, here, source);
  if (here.is_inside()) return out;
  auto const& [cut, row, at, place, inside, electrode] = here;
  Box const& own = mesh_.box(l, b);
  for (std::size_t side = 0; side < 6; ++side) {
    int const axis = int(side) / 2;
    bool const ends = cut.cell[axis] == (side % 2 == 0 ? own.lower : own.upper)[axis];
    if (!ends || mesh_.plan(l, b).faces[side].wall < 0 || row.neighbour(side) == 0) continue;
    Boundary const kind = mesh_.hierarchy().domain().boundary[axis][side % 2];
    out += row.neighbour(side) * wall_ghost(kind, mesh_.level(l).spacing()[axis]).datum *
           ghosts_.wall_datum(l, b, cut.cell, int(side), source.walls);
  }
  return out;
}

/// f less what wall data add to the Laplacian, of a plane of cells; zero in covered ones.
void SecondOrderResidual::right_hand_side_plane(int l, int b, int k, Source const& source) {
  source_plane(l, b, k, source);
  for_each_wall_term(l, b, k, source, [&](std::ptrdiff_t at, Real term) { plane_[std::size_t(at)] -= term; });
  if (mesh_.metal()) right_hand_side_beside_metal(l, b, k, source);
  mesh_.clear_covered(l, b, k, plane_.data());
}

/// Call f(place in the plane, term) for what wall data add to the Laplacian in plane k of a box.
template <class F>
void SecondOrderResidual::for_each_wall_term(int l, int b, int k, Source const& source, F&& f) const {
  Real3 const& h = mesh_.level(l).spacing();
  for (int face = 0; face < 6; ++face) {
    int const wall = mesh_.plan(l, b).faces[face].wall, axis = face / 2;
    if (wall < 0) continue;
    Boundary const kind = mesh_.hierarchy().domain().boundary[axis][face % 2];
    Real const weight = datum_weight(mesh_.equation(l), axis, wall_ghost(kind, h[axis]));
    for_each_on_face(mesh_.box(l, b), face, k, [&](std::ptrdiff_t at, int u, int v, int nu) {
      f(at, weight * source.walls[std::size_t(l)].datum[std::size_t(wall + u + std::ptrdiff_t(v) * nu)]);
    });
  }
}

/// The magnitudes of all terms of that, added up; zero in covered cells.
void SecondOrderResidual::term_sizes_plane(int l, int b, int k, Source const& source) {
  source_sizes_plane(l, b, k, source);
  for_each_wall_term(l, b, k, source, [&](std::ptrdiff_t at, Real term) { plane_[std::size_t(at)] += std::abs(term); });
  mesh_.clear_covered(l, b, k, plane_.data());
}

/// Of phi across the cut sides of a cell, each outwards; `rho`: of the cell, whose potential is at `phi`.
std::array<Real, 6> SecondOrderResidual::differences(int l, int b, CompositeMesh::CutHere const& here, Real rho,
                                                     Real const* phi, Source const& source) const {
  CutCell const& cut = here.cell;
  std::size_t shortest = 0;
  for (std::size_t side = 0; side < 6; ++side)
    if (cut.is_cut(side) && !(cut.is_cut(shortest) && cut.arm[shortest] <= cut.arm[side])) shortest = side;
  bool const is_short = cut.arm[shortest] <= short_arm;
  std::array<Real, 6> out{};
  for (std::size_t side = 0; side < 6; ++side)
    if (here.row.surface(side) != 0)
      out[side] =
          ghosts_.line_through(l, b, here, int(side) / 2, phi, source.walls, source.potentials).across(int(side) % 2);
    else if (is_short)
      out[side] = ghosts_.value_beyond(l, b, here, int(side), phi) - *phi;
  if (!is_short) return out;
  Equation const equation = mesh_.equation(l);
  Real left = source.background.right_hand_side(rho) + equation.shift * *phi;
  for (std::size_t side = 0; side < 6; ++side)
    if (side != shortest) left -= equation.weight[int(side) / 2] * out[side];
  out[shortest] = left / equation.weight[int(shortest) / 2];
  return out;
}

void SecondOrderResidual::for_each_charge(Source const& source, Field const& phi, OfCharge const& f) {
  visit(phi, source.walls, source.potentials, [&](int l, int b) {
    Box const& own = mesh_.box(l, b);
    Equation const equation = mesh_.equation(l);
    for (int k = 0; k < own.extent(2); ++k)
      mesh_.for_each_in_metal(
          l, b, k, Covered::skip,
          [&](CompositeMesh::CutHere const& here) {
            if (!here.cell.is_cut()) return;
            std::size_t const place = std::size_t(mesh_.offset(l, b) + k * own.stride(2) + here.place);
            auto const across = differences(l, b, here, source.rho.level(l)[place], &phi.level(l)[place], source);
            for (std::size_t n = 0; n < 6; ++n)
              if (here.cell.is_cut(n) && here.row.surface(n) != 0)
                f(l, place, here.cell.electrode[n],
                  vacuum_permittivity * mesh_.volume(l) * equation.weight[int(n) / 2] * across[n]);
          },
          [](std::ptrdiff_t, int, int) {});
    for (SharedFace const& face : mesh_.shared_faces(l)) {
      if (!own.contains(face.cell) || mesh_.is_covered(l, b, face.cell)) continue;
      if (auto const difference = ghosts_.difference_beyond(l, b, face.cell, int(face.side)))
        f(l, std::size_t(mesh_.offset(l, b) + own.offset(face.cell)), face.electrode,
          vacuum_permittivity * mesh_.volume(l) * equation.weight[int(face.side) / 2] * face.share * *difference);
    }
  });
}

/// Call f(cell, weight) for the weights that cells have in the fits in gaps for their own ghosts behind a face of a
/// box; cells count from the first one of the box.
template <class F>
void SecondOrderResidual::for_each_own_weight_in_gaps(int l, int b, int face, F&& f) const {
  Level const& level = mesh_.level(l);
  int const axis = face / 2, side = face % 2;
  auto const [u, v] = tangential_axes(axis);
  Interface const& i = mesh_.plan(l).interfaces[std::size_t(mesh_.plan(l, b).faces[face].interface)];
  Index3 cell, own;  // in the box, and from the first child of the cell behind the face
  cell[axis] = side == 0 ? 0 : mesh_.box(l, b).extent(axis) - 1, own[axis] = side == 0 ? 2 : -1;
  auto const is_own = [&](GapFit::Term const& term) {  // or an image of it
    bool out = term.fine;
    for (std::size_t d = 0; d < 3; ++d) {
      int const away = term.offset[d] - own[d];
      out = out && (level.periodic()[d] ? away % level.domain().extent(int(d)) : away) == 0;
    }
    return out;
  };
  mesh_.plan(l).for_each_gap(i, [&](int coarse_u, int coarse_v, GapFit const& fit) {
    for (own[v] = 0; own[v] < 2; ++own[v])
      for (own[u] = 0; own[u] < 2; ++own[u]) {
        cell[u] = 2 * (i.u + coarse_u) + own[u], cell[v] = 2 * (i.v + coarse_v) + own[v];
        Real weight = 0;
        for (auto const& term : fit.terms)
          if (is_own(term)) weight += term.weight[std::size_t(own[v])][std::size_t(own[u])];
        f(cell, weight);
      }
  });
}

/// The diagonal of the Laplacian times phi, of a plane of cells; zero in covered ones.
void SecondOrderResidual::diagonal_plane(int l, int b, int k, Field const& phi) {
  Box const& own = mesh_.box(l, b);
  Index3 const pitch = own.strides();
  Real3 const& h = mesh_.level(l).spacing();
  Equation const equation = mesh_.equation(l);
  Real const* const cells = phi.level(l).data() + mesh_.offset(l, b) + std::ptrdiff_t(k) * pitch[2];
  for (int i = 0; i < pitch[2]; ++i) plane_[std::size_t(i)] = -equation.diagonal() * cells[i];
  for (int f = 0; f < 6; ++f) {
    FacePlan const& face = mesh_.plan(l, b).faces[f];
    int const axis = f / 2;
    Real const c = equation.weight[axis];
    if (face.wall >= 0) {
      Real const first = wall_ghost(mesh_.hierarchy().domain().boundary[axis][f % 2], h[axis]).first;
      for_each_on_face(own, f, k,
                       [&](std::ptrdiff_t at, int, int, int) { plane_[std::size_t(at)] += c * first * cells[at]; });
    } else if (face.interface >= 0) {
      Interface const& i = mesh_.plan(l).interfaces[std::size_t(face.interface)];
      for_each_on_face(own, f, k, [&](std::ptrdiff_t at, int u, int v, int) {
        int const a = u / 2 - i.u, e = v / 2 - i.v;
        if (a < 0 || a >= i.nu || e < 0 || e >= i.nv) return;
        if (mesh_.plan(l).fits[std::size_t(i.fits + a + e * i.nu)] == no_fit) return;
        plane_[std::size_t(at)] += c * interface_ghost::first * cells[at];
      });
      for_each_own_weight_in_gaps(l, b, f, [&](Index3 const& cell, Real weight) {
        std::ptrdiff_t const at = cell[0] + std::ptrdiff_t(cell[1]) * pitch[1];
        if (cell[2] == k) plane_[std::size_t(at)] += c * interface_ghost::coarse * weight * cells[at];
      });
    }
  }
  mesh_.for_each_in_metal(
      l, b, k, Covered::skip,
      [&](CompositeMesh::CutHere const& here) {
        plane_[std::size_t(here.place)] = -here.row.diagonal * cells[here.place];
      },
      [&](std::ptrdiff_t at, int n, int) { std::fill_n(&plane_[std::size_t(at)], n, 0.0); });
  mesh_.clear_covered(l, b, k, plane_.data());
}

// ---- residual and norms ----

/// f of a plane of cells, covered ones included.
void CompositeResidual::source_plane(int l, int b, int k, Source const& source) {
  std::ptrdiff_t const cells = mesh_.box(l, b).stride(2);
  Background const background = source.background;
  Real const* const rho = source.rho.level(l).data() + mesh_.offset(l, b) + k * cells;
  kernels::for_each_part(0, cells, [&](std::ptrdiff_t begin, std::ptrdiff_t end) {
    fetch<Use::read>(rho + begin + page<Real>, end - begin);
    for (std::ptrdiff_t i = begin; i < end; ++i) plane_[std::size_t(i)] = background.right_hand_side(rho[i]);
  });
}

/// The magnitudes of its terms, added up.
void CompositeResidual::source_sizes_plane(int l, int b, int k, Source const& source) {
  std::ptrdiff_t const cells = mesh_.box(l, b).stride(2);
  Real const* const rho = source.rho.level(l).data() + mesh_.offset(l, b) + k * cells;
  Real const background = std::abs(source.background.mean);
  for (std::ptrdiff_t i = 0; i < cells; ++i)
    plane_[std::size_t(i)] = Background::inverse_permittivity * std::abs(rho[i]) + background;
}

template <class T>
Real CompositeResidual::residual(Source const& source, Field const& phi, Norm norm, std::vector<Real> const& scale,
                                 Blocks<T> const& residual) {
  Magnitude magnitude(norm);
  visit(phi, source.walls, source.potentials, [&](int l, int b) {
    for (int k = 0; k < mesh_.box(l, b).extent(2); ++k) {
      residual_plane(l, b, k, source, phi);
      write_plane(l, b, k, scale, residual, magnitude);
    }
  });
  clear_fully_covered(residual);
  return magnitude.over(mesh_.comm());
}
template Real CompositeResidual::residual(Source const&, Field const&, Norm, std::vector<Real> const&,
                                          Blocks<float> const&);
template Real CompositeResidual::residual(Source const&, Field const&, Norm, std::vector<Real> const&,
                                          Blocks<Real> const&);

/// A plane of residuals, times the scale of its level, after its part of a norm is taken.
template <class T>
void CompositeResidual::write_plane(int l, int b, int k, std::vector<Real> const& scale, Blocks<T> const& residual,
                                    Magnitude& magnitude) const {
  mesh_.write_plane(l, b, k, plane_.data(), scale[std::size_t(l)], residual[std::size_t(l)][std::size_t(b)],
                    [&](Real const* cells, std::ptrdiff_t count) { magnitude.add(cells, count, mesh_.volume(l)); });
}

/// Zeros into the boxes without uncovered cells.
template <class T>
void CompositeResidual::clear_fully_covered(Blocks<T> const& blocks) {
  mesh_.for_each_box([&](int l, int b) {
    if (mesh_.plan(l, b).is_fully_covered) mesh_.clear(l, b, blocks[std::size_t(l)][std::size_t(b)]);
  });
}

/// Call use(level, box, plane, cells) after fill(level, box, plane) for each plane of the boxes with uncovered cells.
template <class Fill, class Use>
void CompositeResidual::for_each_plane(Fill&& fill, Use&& use) {
  mesh_.for_each_box([&](int l, int b) {
    if (mesh_.plan(l, b).is_fully_covered) return;
    for (int k = 0; k < mesh_.box(l, b).extent(2); ++k) {
      fill(l, b, k);
      use(l, b, k, std::ptrdiff_t(mesh_.box(l, b).extent(0)) * mesh_.box(l, b).extent(1));
    }
  });
}

template <class T>
Real CompositeResidual::residual_of_zero(Source const& source, Norm norm, std::vector<Real> const& scale,
                                         Blocks<T> const& residual) {
  Magnitude magnitude(norm);
  for_each_plane([&](int l, int b, int k) { right_hand_side_plane(l, b, k, source); },
                 [&](int l, int b, int k, std::ptrdiff_t) { write_plane(l, b, k, scale, residual, magnitude); });
  clear_fully_covered(residual);
  return magnitude.over(mesh_.comm());
}
template Real CompositeResidual::residual_of_zero(Source const&, Norm, std::vector<Real> const&, Blocks<float> const&);
template Real CompositeResidual::residual_of_zero(Source const&, Norm, std::vector<Real> const&, Blocks<Real> const&);

Real CompositeResidual::right_hand_side_norm(Source const& source, Norm norm) {
  Magnitude magnitude(norm);
  for_each_plane([&](int l, int b, int k) { right_hand_side_plane(l, b, k, source); },
                 [&](int l, int, int, std::ptrdiff_t n) { magnitude.add(plane_.data(), n, mesh_.volume(l)); });
  return magnitude.over(mesh_.comm());
}

IntegralOfSource CompositeResidual::integrate_right_hand_side(Source const& source) {
  std::array<Real, 2> sums{};
  auto const add_to = [&](Real& total) {
    return [&](int l, int, int, std::ptrdiff_t n) {
      Real sum = 0;
      for (std::ptrdiff_t i = 0; i < n; ++i) sum += plane_[std::size_t(i)];
      total += mesh_.level(l).cell_volume() * sum;
    };
  };
  for_each_plane([&](int l, int b, int k) { right_hand_side_plane(l, b, k, source); }, add_to(sums[0]));
  for_each_plane([&](int l, int b, int k) { term_sizes_plane(l, b, k, source); }, add_to(sums[1]));
  mesh_.comm().sum_each(sums);
  return {sums[0], sums[1]};
}

Real CompositeResidual::diagonal_norm(Field const& phi, Norm norm) {
  Magnitude magnitude(norm);
  for_each_plane([&](int l, int b, int k) { diagonal_plane(l, b, k, phi); },
                 [&](int l, int, int, std::ptrdiff_t n) { magnitude.add(plane_.data(), n, mesh_.volume(l)); });
  return magnitude.over(mesh_.comm());
}

}  // namespace amrpic
