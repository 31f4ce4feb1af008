#include "matrixfree/composite.hpp"

#include <algorithm>
#include <cmath>

#include "matrixfree/composite_kernels.hpp"
#include "mesh/means.hpp"
#include "stencil/boundary.hpp"

namespace amrpic {

namespace {

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

CompositeLaplacian::CompositeLaplacian(std::shared_ptr<Hierarchy const> hierarchy, Real shift, Real3 const& stretch)
    : hierarchy_(std::move(hierarchy)), shift_(shift), stretch_(stretch), plan_(*hierarchy_) {
  std::array<std::size_t, 3> face{0, 0, 0};
  std::size_t row = 0;
  for (int l = 0; l < hierarchy_->level_count(); ++l) {
    fluxes_.emplace_back(std::size_t(plan(l).fluxes));
    for (int b = 0; b < boxes(l); ++b)
      for (int d = 0; d < 3; ++d) {
        auto const [u, v] = tangential_axes(d);
        face[d] = std::max(face[d], std::size_t(box(l, b).extent(u)) * std::size_t(box(l, b).extent(v)));
        row = std::max(row, std::size_t(box(l, b).extent(d)));
      }
  }
  for (int f = 0; f < 6; ++f) beyond_[f].resize(face[f / 2]);
  coarse_.resize((row / 2 + 4) * (row / 2 + 4));
  fits_.resize(2 * row);
  plane_.resize(2 * 3 * face[2]);
}

Real CompositeLaplacian::volume(int l) const {
  return level(l).cell_volume() / (stretch_[0] * stretch_[1] * stretch_[2]);
}

template <class F>
void CompositeLaplacian::for_each_box(F&& f) {
  for (int l = 0; l < hierarchy_->level_count(); ++l)
    for (int b = 0; b < boxes(l); ++b) f(l, b);
}

// ---- what surrounds a box ----

/// Call f(level, box) for all boxes of this rank, finest level first, with the ghosts of the box at hand and the fluxes
/// from the finer level through its faces; and done(level) after all of a level. Hidden boxes have neither interfaces
/// nor uncovered cells.
void CompositeLaplacian::visit(Field const& phi, std::vector<Walls> const& walls, Hidden hidden,
                               std::function<void(int, int)> const& f, std::function<void(int)> const& done) {
  plan_.cells.start([&](Piece const& piece, Real* out) { pack_cells(phi, piece, out); });
  bool waiting = true;
  for (int l = hierarchy_->level_count() - 1; l >= 0; --l) {
    if (hierarchy_->has_finer(l)) plan_.levels[l].finer_fluxes.finish();
    for (bool remote : {false, true}) {
      if (remote && waiting) {
        plan_.cells.finish();
        waiting = false;
      }
      for (int b = 0; b < boxes(l); ++b) {
        if (plan(l, b).remote != remote || (plan(l, b).hidden && hidden == Hidden::skip)) continue;
        surround(l, b, phi, walls[l]);
        f(l, b);
      }
    }
    if (l > 0) send_fluxes(l);
    if (done) done(l);
  }
}

/// The cells of a piece, x fastest; returns the place after the last.
Real* CompositeLaplacian::pack_cells(Field const& field, Piece const& piece, Real* out) const {
  Box const& own = level(piece.level).box(piece.box);
  Real const* from = field.level(piece.level).data() + level(piece.level).local_offset(piece.box);
  for (int k = piece.part.lower[2]; k <= piece.part.upper[2]; ++k)
    for (int j = piece.part.lower[1]; j <= piece.part.upper[1]; ++j)
      out = std::copy_n(from + own.offset({piece.part.lower[0], j, k}), piece.part.extent(0), out);
  return out;
}

void CompositeLaplacian::send_fluxes(int l) {
  plan_.levels[l - 1].finer_fluxes.start([&](Piece const& piece, Real* out) {
    auto const [u, v] = tangential_axes(piece.face / 2);
    int const b = piece.box - level(l).first_local_box();
    Interface const& i = plan(l).interfaces[std::size_t(plan(l, b).faces[std::size_t(piece.face)].interface)];
    Box const parents = box(l, b).coarsen(refinement_ratio);
    for (int y = piece.part.lower[v]; y <= piece.part.upper[v]; ++y) {
      std::ptrdiff_t const from = i.fluxes + (piece.part.lower[u] - parents.lower[u] - i.u) +
                                  std::ptrdiff_t(i.nu) * (y - parents.lower[v] - i.v);
      out = std::copy_n(fluxes_[l].data() + from, piece.part.extent(u), out);
    }
  });
}

/// Ghosts of a box, into `beyond_`.
void CompositeLaplacian::surround(int l, int b, Field const& phi, Walls const& walls) {
  for (int axis = 0; axis < 3; ++axis)
    for (int side = 0; side < 2; ++side) {
      int const f = 2 * axis + side;
      FacePlan const& face = plan(l, b).faces[f];
      int const pitch = box(l, b).extent(tangential_axes(axis)[0]);
      if (face.wall >= 0) {
        fill_wall(l, b, axis, side, phi.level(l).data() + offset(l, b), walls.datum.data() + face.wall);
        continue;
      }
      for (int r = face.neighbours.first; r < face.neighbours.last; ++r)
        copy(plan(l).neighbours[r], phi.level(l).data(), beyond_[f].data(), pitch);
      if (face.interface >= 0) fill_interface(l, b, axis, side, phi);
    }
}

void CompositeLaplacian::copy(Rectangle const& r, Real const* own, Real* to, std::ptrdiff_t pitch) const {
  Real const* from = (r.owner == Rectangle::here ? own : plan_.cells.values(r.owner)) + r.from;
  to += r.u + pitch * r.v;
  for (int v = 0; v < r.nv; ++v, from += r.pv, to += pitch) {
    if (r.pu == 1)
      std::copy_n(from, r.nu, to);
    else
      for (int u = 0; u < r.nu; ++u) to[u] = from[std::ptrdiff_t(u) * r.pu];
  }
}

void CompositeLaplacian::fill_wall(int l, int b, int axis, int side, Real const* phi, Real const* data) {
  WallGhost const ghost =
      wall_ghost(hierarchy_->domain().boundary[std::size_t(axis)][std::size_t(side)], level(l).spacing()[axis]);
  Box const& own = box(l, b);
  auto const [u, v] = tangential_axes(axis);
  Index3 const pitch = pitches(own);
  std::ptrdiff_t const inward = side == 0 ? pitch[axis] : -pitch[axis];
  Real const* first = phi + (side == 0 ? 0 : std::ptrdiff_t(own.extent(axis) - 1) * pitch[axis]);
  Real* out = beyond_[2 * axis + side].data();
  for (int y = 0; y < own.extent(v); ++y, first += pitch[v])
    for (int x = 0; x < own.extent(u); ++x) {
      Real const* cell = first + std::ptrdiff_t(x) * pitch[u];
      *out++ = ghost(cell[0], cell[inward], *data++);
    }
}

/// Ghosts in front of coarser cells, and what the four ghosts of each coarse face leave for the coarser cell behind it:
/// the sum of phi_1 - ghost, from which its outward derivative is a quarter of that over the fine spacing.
void CompositeLaplacian::fill_interface(int l, int b, int axis, int side, Field const& phi) {
  int const f = 2 * axis + side;
  Interface const& i = plan(l).interfaces[std::size_t(plan(l, b).faces[f].interface)];
  std::ptrdiff_t const coarse_pitch = i.nu + 2 * i.margin;
  for (int r = i.coarse.first; r < i.coarse.last; ++r)
    copy(plan(l).coarse[r], phi.level(l - 1).data(), coarse_.data(), coarse_pitch);

  Box const& own = box(l, b);
  auto const [u, v] = tangential_axes(axis);
  Index3 const pitch = pitches(own);
  std::ptrdiff_t const pu = pitch[u], pv = pitch[v], inward = side == 0 ? pitch[axis] : -pitch[axis];
  Real const* const first = phi.level(l).data() + offset(l, b) +
                            (side == 0 ? 0 : std::ptrdiff_t(own.extent(axis) - 1) * pitch[axis]) + 2 * i.u * pu;
  std::ptrdiff_t const ghost_pitch = own.extent(u);
  Real* const ghosts = beyond_[f].data() + 2 * i.u;
  Real* const star = fits_.data();
  for (int row = 0; row < i.nv; ++row) {
    FitNumber const* fits = plan(l).fits.data() + i.fits + std::ptrdiff_t(row) * i.nu;
    Real* flux = fluxes_[l].data() + i.fluxes + std::ptrdiff_t(row) * i.nu;
    fit_row(fits, i.nu, coarse_.data() + i.margin + (i.margin + row) * coarse_pitch, coarse_pitch, star,
            star + 2 * i.nu);
    for_each_run(fits, i.nu, [&](int start, int count, FitNumber) {
      std::fill_n(flux + start, count, 0.0);
      for (int half = 0; half < 2; ++half) {
        int const y = 2 * (i.v + row) + half;
        Real const* cell = first + y * pv;
        Real* ghost = ghosts + y * ghost_pitch;
        Real const* fit = star + std::ptrdiff_t(half) * 2 * i.nu;
        for (int m = start; m < start + count; ++m) {
          Real const *p = cell + 2 * m * pu, *q = p + pu;
          Real const lower = ghost_at_interface(fit[2 * m], p[0], p[inward]);
          Real const upper = ghost_at_interface(fit[2 * m + 1], q[0], q[inward]);
          ghost[2 * m] = lower, ghost[2 * m + 1] = upper;
          flux[m] += (p[0] - lower) + (q[0] - upper);
        }
      }
    });
  }
}

// ---- planes of a box ----

/// Call f(place in the box, axis, side, excess) for each uncovered cell of a plane and each of its faces with a refined
/// cell beyond: the difference of phi across the face by the finer fluxes, less that to the covered neighbour.
template <class F>
void CompositeLaplacian::for_each_refined(int l, int b, int k, Real const* phi, F&& f) const {
  Box const& own = box(l, b);
  Index3 const pitch = pitches(own);
  for (int s = plan(l, b).refined.first; s < plan(l, b).refined.last; ++s) {
    RefinedSide const& r = plan(l).refined[std::size_t(s)];
    if (k < r.cells.lower[2] || k > r.cells.upper[2]) continue;
    auto const [u, v] = tangential_axes(r.axis);
    Real const* const fluxes =
        (r.fluxes.owner == Rectangle::here ? fluxes_[l + 1].data() : plan(l).finer_fluxes.values(r.fluxes.owner)) +
        r.fluxes.from;
    int const layer = r.cells.lower[r.axis];
    bool const inside = r.side == 0 ? layer > 0 : layer + 1 < own.extent(r.axis);
    std::ptrdiff_t const outward = r.side == 0 ? -pitch[r.axis] : pitch[r.axis];
    Real const* const beyond = beyond_[2 * r.axis + r.side].data();
    Index3 cell{0, 0, k};
    for (cell[1] = r.cells.lower[1]; cell[1] <= r.cells.upper[1]; ++cell[1])
      for (cell[0] = r.cells.lower[0]; cell[0] <= r.cells.upper[0]; ++cell[0]) {
        std::ptrdiff_t const at = cell[0] + std::ptrdiff_t(cell[1]) * pitch[1] + std::ptrdiff_t(k) * pitch[2];
        Real const flux = fluxes[std::ptrdiff_t(cell[u] - r.cells.lower[u]) * r.fluxes.pu +
                                 std::ptrdiff_t(cell[v] - r.cells.lower[v]) * r.fluxes.pv];
        Real const covered = inside ? phi[at + outward] : beyond[cell[u] + std::ptrdiff_t(cell[v]) * own.extent(u)];
        f(at, r.axis, r.side, fine_face_weight * flux - (covered - phi[at]));
      }
  }
}

/// Call f(place in the plane, count) for each row of covered cells in plane k of a box.
template <class F>
void CompositeLaplacian::for_each_covered_row(int l, int b, int k, F&& f) const {
  for (int c = plan(l, b).covered.first; c < plan(l, b).covered.last; ++c) {
    Box const& part = plan(l).covered[std::size_t(c)];
    if (k < part.lower[2] || k > part.upper[2]) continue;
    for (int j = part.lower[1]; j <= part.upper[1]; ++j)
      f(part.lower[0] + std::ptrdiff_t(j) * box(l, b).extent(0), part.extent(0));
  }
}

void CompositeLaplacian::clear_covered(int l, int b, int k, Real* plane) const {
  for_each_covered_row(l, b, k, [&](std::ptrdiff_t at, int n) { std::fill_n(plane + at, n, 0.0); });
}

/// f - L phi of a plane of cells, into `plane_`; zero in covered ones.
void CompositeLaplacian::residual_plane(int l, int b, int k, Source const& source, Field const& phi) {
  Box const& own = box(l, b);
  int const nx = own.extent(0), ny = own.extent(1), nz = own.extent(2);
  std::ptrdiff_t const plane = std::ptrdiff_t(nx) * ny;
  auto const& values = phi.level(l);
  Real const* const cells = values.data() + offset(l, b);
  Real const* const rho = source.rho.level(l).data() + offset(l, b) + k * plane;
  kernels::Residual const formula{equation(l), source.background};
  Real const* const c = cells + k * plane;
  Real const* const below = k > 0 ? c - plane : beyond_[4].data();
  Real const* const above = k + 1 < nz ? c + plane : beyond_[5].data();
  auto neighbours = [&](int j) {
    std::ptrdiff_t const at = std::ptrdiff_t(j) * nx;
    return kernels::Neighbours{j > 0 ? c + at - nx : beyond_[2].data() + std::ptrdiff_t(k) * nx,
                               j + 1 < ny ? c + at + nx : beyond_[3].data() + std::ptrdiff_t(k) * nx, below + at,
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
    kernels::residual_ends(formula, nx, c + at, neighbours(j), beyond_[0][end], beyond_[1][end], rho + at,
                           plane_.data() + at);
  }
  for_each_refined(l, b, k, cells, [&](std::ptrdiff_t at, int axis, int, Real excess) {
    plane_[std::size_t(at - k * plane)] -= formula.equation.weight[axis] * excess;
  });
  clear_covered(l, b, k, plane_.data());
}

/// f less what wall data add to the Laplacian, of a plane of cells; zero in covered ones.
void CompositeLaplacian::right_hand_side_plane(int l, int b, int k, Source const& source) {
  std::ptrdiff_t const cells = pitches(box(l, b))[2];
  Background const background = source.background;
  Real const* const rho = source.rho.level(l).data() + offset(l, b) + k * cells;
  kernels::for_each_part(0, cells, [&](std::ptrdiff_t begin, std::ptrdiff_t end) {
    fetch<Use::read>(rho + begin + page<Real>, end - begin);
    for (std::ptrdiff_t i = begin; i < end; ++i) plane_[std::size_t(i)] = background.right_hand_side(rho[i]);
  });
  for_each_wall_term(l, b, k, source, [&](std::ptrdiff_t at, Real term) { plane_[std::size_t(at)] -= term; });
  clear_covered(l, b, k, plane_.data());
}

/// Call f(place in the plane, term) for what wall data add to the Laplacian in plane k of a box.
template <class F>
void CompositeLaplacian::for_each_wall_term(int l, int b, int k, Source const& source, F&& f) const {
  Real3 const& h = level(l).spacing();
  for (int face = 0; face < 6; ++face) {
    int const wall = plan(l, b).faces[face].wall, axis = face / 2;
    if (wall < 0) continue;
    WallGhost const ghost = wall_ghost(hierarchy_->domain().boundary[axis][face % 2], h[axis]);
    Real const weight = equation(l).weight[axis] * ghost.datum;
    for_each_on_face(box(l, b), face, k, [&](std::ptrdiff_t at, int u, int v, int nu) {
      f(at, weight * source.walls[l].datum[std::size_t(wall + u + std::ptrdiff_t(v) * nu)]);
    });
  }
}

/// The magnitudes of all terms of that, added up; zero in covered cells.
void CompositeLaplacian::term_sizes_plane(int l, int b, int k, Source const& source) {
  std::ptrdiff_t const cells = pitches(box(l, b))[2];
  Real const* const rho = source.rho.level(l).data() + offset(l, b) + k * cells;
  Real const background = std::abs(source.background.mean);
  for (std::ptrdiff_t i = 0; i < cells; ++i)
    plane_[std::size_t(i)] = Background::inverse_permittivity * std::abs(rho[i]) + background;
  for_each_wall_term(l, b, k, source, [&](std::ptrdiff_t at, Real term) { plane_[std::size_t(at)] += std::abs(term); });
  clear_covered(l, b, k, plane_.data());
}

/// The diagonal of the Laplacian times phi, of a plane of cells; zero in covered ones.
void CompositeLaplacian::diagonal_plane(int l, int b, int k, Field const& phi) {
  Box const& own = box(l, b);
  Index3 const pitch = pitches(own);
  Real3 const& h = level(l).spacing();
  Equation const equation = this->equation(l);
  Real const* const cells = phi.level(l).data() + offset(l, b) + std::ptrdiff_t(k) * pitch[2];
  for (int i = 0; i < pitch[2]; ++i) plane_[std::size_t(i)] = -equation.diagonal() * cells[i];
  for (int f = 0; f < 6; ++f) {
    FacePlan const& face = plan(l, b).faces[f];
    int const axis = f / 2;
    Real const c = equation.weight[axis];
    if (face.wall >= 0) {
      Real const first = wall_ghost(hierarchy_->domain().boundary[axis][f % 2], h[axis]).first;
      for_each_on_face(own, f, k,
                       [&](std::ptrdiff_t at, int, int, int) { plane_[std::size_t(at)] += c * first * cells[at]; });
    } else if (face.interface >= 0) {
      Interface const& i = plan(l).interfaces[std::size_t(face.interface)];
      for_each_on_face(own, f, k, [&](std::ptrdiff_t at, int u, int v, int) {
        int const a = u / 2 - i.u, e = v / 2 - i.v;
        if (a < 0 || a >= i.nu || e < 0 || e >= i.nv) return;
        if (plan(l).fits[std::size_t(i.fits + a + e * i.nu)] == no_fit) return;
        plane_[std::size_t(at)] += c * interface_ghost::first * cells[at];
      });
    }
  }
  clear_covered(l, b, k, plane_.data());
}

// ---- residual and norms ----

template <class T>
Real CompositeLaplacian::residual(Source const& source, Field const& phi, Norm norm, std::vector<Real> const& scale,
                                  Blocks<T> const& residual) {
  Magnitude magnitude(norm);
  visit(phi, source.walls, Hidden::skip, [&](int l, int b) {
    std::ptrdiff_t const cells = std::ptrdiff_t(box(l, b).extent(0)) * box(l, b).extent(1);
    for (int k = 0; k < box(l, b).extent(2); ++k) {
      residual_plane(l, b, k, source, phi);
      magnitude.add(plane_.data(), cells, volume(l));
      write_plane(l, b, k, scale[std::size_t(l)], residual[std::size_t(l)][std::size_t(b)]);
    }
  });
  clear_hidden(residual);
  return magnitude.over(hierarchy_->comm());
}
template Real CompositeLaplacian::residual(Source const&, Field const&, Norm, std::vector<Real> const&,
                                           Blocks<float> const&);
template Real CompositeLaplacian::residual(Source const&, Field const&, Norm, std::vector<Real> const&,
                                           Blocks<Real> const&);

/// Zeros into the boxes without uncovered cells.
template <class T>
void CompositeLaplacian::clear_hidden(Blocks<T> const& blocks) {
  for_each_box([&](int l, int b) {
    for (int k = 0; plan(l, b).hidden && k < box(l, b).extent(2); ++k)
      write_plane(l, b, k, 0, blocks[std::size_t(l)][std::size_t(b)]);
  });
}

/// Call use(level, box, plane, cells) after fill(level, box, plane) for each plane of the boxes with uncovered cells.
template <class Fill, class Use>
void CompositeLaplacian::for_each_plane(Fill&& fill, Use&& use) {
  for_each_box([&](int l, int b) {
    if (plan(l, b).hidden) return;
    for (int k = 0; k < box(l, b).extent(2); ++k) {
      fill(l, b, k);
      use(l, b, k, std::ptrdiff_t(box(l, b).extent(0)) * box(l, b).extent(1));
    }
  });
}

template <class T>
Real CompositeLaplacian::residual_of_zero(Source const& source, Norm norm, std::vector<Real> const& scale,
                                          Blocks<T> const& residual) {
  Magnitude magnitude(norm);
  for_each_plane([&](int l, int b, int k) { right_hand_side_plane(l, b, k, source); },
                 [&](int l, int b, int k, std::ptrdiff_t n) {
                   magnitude.add(plane_.data(), n, volume(l));
                   write_plane(l, b, k, scale[std::size_t(l)], residual[std::size_t(l)][std::size_t(b)]);
                 });
  clear_hidden(residual);
  return magnitude.over(hierarchy_->comm());
}
template Real CompositeLaplacian::residual_of_zero(Source const&, Norm, std::vector<Real> const&, Blocks<float> const&);

Real CompositeLaplacian::right_hand_side_norm(Source const& source, Norm norm) {
  Magnitude magnitude(norm);
  for_each_plane([&](int l, int b, int k) { right_hand_side_plane(l, b, k, source); },
                 [&](int l, int, int, std::ptrdiff_t n) { magnitude.add(plane_.data(), n, volume(l)); });
  return magnitude.over(hierarchy_->comm());
}

CompositeLaplacian::Integrals CompositeLaplacian::integrate_right_hand_side(Source const& source) {
  Real sums[2] = {0, 0};
  auto const add_to = [&](Real& total) {
    return [&](int l, int, int, std::ptrdiff_t n) {
      Real sum = 0;
      for (std::ptrdiff_t i = 0; i < n; ++i) sum += plane_[std::size_t(i)];
      total += level(l).cell_volume() * sum;
    };
  };
  for_each_plane([&](int l, int b, int k) { right_hand_side_plane(l, b, k, source); }, add_to(sums[0]));
  for_each_plane([&](int l, int b, int k) { term_sizes_plane(l, b, k, source); }, add_to(sums[1]));
  MPI_Allreduce(MPI_IN_PLACE, sums, 2, MPI_DOUBLE, MPI_SUM, hierarchy_->comm());
  return {sums[0], sums[1]};
}

Real CompositeLaplacian::diagonal_norm(Field const& phi, Norm norm) {
  Magnitude magnitude(norm);
  for_each_plane([&](int l, int b, int k) { diagonal_plane(l, b, k, phi); },
                 [&](int l, int, int, std::ptrdiff_t n) { magnitude.add(plane_.data(), n, volume(l)); });
  return magnitude.over(hierarchy_->comm());
}

// ---- corrections and means ----

/// Call set(), which writes a plane of cells; covered ones keep the means that they hold.
template <class Set>
void CompositeLaplacian::set_uncovered(int l, int b, int k, Real* plane, Set&& set) {
  Real* end = plane_.data();
  for_each_covered_row(l, b, k, [&](std::ptrdiff_t at, int n) { end = std::copy_n(plane + at, n, end); });
  set();
  Real const* kept = plane_.data();
  for_each_covered_row(l, b, k, [&](std::ptrdiff_t at, int n) {
    std::copy_n(kept, n, plane + at);
    kept += n;
  });
}

/// phi += scale * correction in the uncovered cells of a plane.
template <class T>
void CompositeLaplacian::add_plane(int l, int b, int k, Block<T> const& correction, Real scale, Real* phi,
                                   Largest<T>& largest) {
  int const nx = box(l, b).extent(0), ny = box(l, b).extent(1);
  set_uncovered(l, b, k, phi, [&] {
    for (int j = 0; j < ny; ++j) {
      T const* __restrict from = correction.origin + j * correction.pitch_y + k * correction.pitch_z;
      Real* __restrict to = phi + std::ptrdiff_t(j) * nx;
      fetch<Use::read>(from + correction.pitch_z, nx);  // rows of a box lie far apart in vectors of the cycle
      fetch<Use::write>(to + page<Real>, nx);
      for (int i = 0; i < nx; ++i) to[i] = fused(scale, Real(from[i]), to[i]);
      largest.add(from, nx);
    }
  });
}

/// Set the parents of planes k and k + 1 of a box that are cells of this rank to the mean of their children.
void CompositeLaplacian::average_pair(int l, int b, int k, Field& phi) const {
  Index3 const pitch = pitches(box(l, b));
  Real const* const cells = phi.level(l).data() + offset(l, b) + std::ptrdiff_t(k) * pitch[2];
  for (int f = plan(l, b).families.first; f < plan(l, b).families.last; ++f) {
    Family const& family = plan(l).families[std::size_t(f)];
    int const plane = (k - family.child[2]) / 2;
    if (k < family.child[2] || plane >= family.parents[2]) continue;
    Real* parent = phi.level(l - 1).data() + family.parent + std::ptrdiff_t(plane) * family.pitch_z;
    Real const* child = cells + family.child[0] + std::ptrdiff_t(family.child[1]) * pitch[1];
    for (int j = 0; j < family.parents[1]; ++j, parent += family.pitch_y, child += 2 * std::ptrdiff_t(pitch[1]))
      average_children(family.parents[0], child, pitch[1], pitch[2], parent);
  }
}

/// The same between ranks, for all boxes of a level.
void CompositeLaplacian::average_across_ranks(int l, Field& phi) {
  LevelPlan& coarse = plan_.levels[std::size_t(l) - 1];
  coarse.finer_means.start([&](Piece const& piece, Real* out) {
    Box const& own = level(l).box(piece.box);
    Index3 const pitch = pitches(own);
    Real const* const cells = phi.level(l).data() + level(l).local_offset(piece.box);
    Box const& part = piece.part;
    for (int k = part.lower[2]; k <= part.upper[2]; ++k)
      for (int j = part.lower[1]; j <= part.upper[1]; ++j, out += part.extent(0))
        average_children(part.extent(0), cells + own.offset({2 * part.lower[0], 2 * j, 2 * k}), pitch[1], pitch[2],
                         out);
  });
  coarse.finer_means.finish();
  for (RemoteMeans const& m : coarse.remote_means) {
    Real const* from = coarse.finer_means.values(m.owner) + m.from;
    for (int k = 0; k < m.parents[2]; ++k)
      for (int j = 0; j < m.parents[1]; ++j, from += m.parents[0])
        std::copy_n(from, m.parents[0],
                    phi.level(l - 1).data() + m.parent + std::ptrdiff_t(j) * m.pitch_y + std::ptrdiff_t(k) * m.pitch_z);
  }
}

void CompositeLaplacian::average_down(Field& phi) {
  for (int l = hierarchy_->level_count() - 1; l > 0; --l) {
    for (int b = 0; b < boxes(l); ++b)
      for (int k = 0; k < box(l, b).extent(2); k += 2) average_pair(l, b, k, phi);
    average_across_ranks(l, phi);
  }
}

template <class T>
Real CompositeLaplacian::add(Blocks<T> const& correction, Real scale, Field& phi) {
  Largest<T> largest;
  for (int l = hierarchy_->level_count() - 1; l >= 0; --l) {
    for (int b = 0; b < boxes(l); ++b) {
      Real* const cells = phi.level(l).data() + offset(l, b);
      Block<T> const& from = correction[std::size_t(l)][std::size_t(b)];
      for (int k = 0; k < box(l, b).extent(2); ++k) {
        // the largest of all cells does not depend on which of the covered ones fill a box
        if (plan(l, b).hidden)
          for (int j = 0; j < box(l, b).extent(1); ++j)
            largest.add(from.origin + j * from.pitch_y + k * from.pitch_z, box(l, b).extent(0));
        else
          add_plane(l, b, k, from, scale, cells + std::ptrdiff_t(k) * pitches(box(l, b))[2], largest);
        if (l > 0 && k % 2 == 1) average_pair(l, b, k - 1, phi);
      }
    }
    if (l > 0) average_across_ranks(l, phi);
  }
  return std::abs(scale) * largest.value();
}
template Real CompositeLaplacian::add(Blocks<float> const&, Real, Field&);
template Real CompositeLaplacian::add(Blocks<Real> const&, Real, Field&);

// ---- the electric field ----

/// Set the field in plane k of a box, whose components there are `e`: in all cells, or in those at faces of the box.
void CompositeLaplacian::field_plane(int l, int b, int k, Where where, Field const& phi,
                                     std::array<Real*, 3> const& e) {
  Box const& own = box(l, b);
  int const nx = own.extent(0), ny = own.extent(1), nz = own.extent(2);
  std::ptrdiff_t const plane = std::ptrdiff_t(nx) * ny;
  Real const* const cells = phi.level(l).data() + offset(l, b);
  Real3 factor;
  for (int d = 0; d < 3; ++d) factor[d] = factor_of_field(l, d);
  for (int j = 0; j < ny; ++j) {
    std::ptrdiff_t const at = std::ptrdiff_t(j) * nx;
    Real const* const c = cells + k * plane + at;
    fetch<Use::read>(c + plane + page<Real>, nx);
    auto difference = [&](int d, Real const* below, Real const* above, int first, int last) {
      Real* __restrict out = e[d] + at;
      for (int i = first; i < last; ++i) out[i] = field_between(factor[d], below[i], above[i]);
    };
    std::size_t const end = std::size_t(j) + std::size_t(k) * std::size_t(ny);
    auto set = [&](int first, int last) {
      difference(0, c - 1, c + 1, std::max(first, 1), std::min(last, nx - 1));
      if (first == 0) e[0][at] = field_between(factor[0], beyond_[0][end], c[1]);
      if (last == nx) e[0][at + nx - 1] = field_between(factor[0], c[nx - 2], beyond_[1][end]);
      difference(1, j > 0 ? c - nx : beyond_[2].data() + std::ptrdiff_t(k) * nx,
                 j + 1 < ny ? c + nx : beyond_[3].data() + std::ptrdiff_t(k) * nx, first, last);
      difference(2, k > 0 ? c - plane : beyond_[4].data() + at, k + 1 < nz ? c + plane : beyond_[5].data() + at, first,
                 last);
    };
    if (where == Where::everywhere || j == 0 || j + 1 == ny || k == 0 || k + 1 == nz) {
      set(0, nx);
    } else {
      set(0, 1);
      set(nx - 1, nx);
    }
  }
  for_each_refined(l, b, k, cells, [&](std::ptrdiff_t at, int axis, int side, Real excess) {
    e[axis][at - k * plane] += (side == 0 ? factor[axis] : -factor[axis]) * excess;
  });
}

std::int64_t CompositeLaplacian::messages() const {
  std::int64_t sum = plan_.cells.messages();
  for (auto const& l : plan_.levels) sum += l.finer_fluxes.messages() + l.finer_means.messages();
  return sum;
}

std::int64_t CompositeLaplacian::message_bytes() const {
  std::int64_t sum = plan_.cells.bytes();
  for (auto const& l : plan_.levels) sum += l.finer_fluxes.bytes() + l.finer_means.bytes();
  return sum;
}

std::size_t CompositeLaplacian::bytes() const {
  std::size_t values = plane_.capacity() + coarse_.capacity() + fits_.capacity();
  for (auto const& face : beyond_) values += face.capacity();
  for (auto const& level : fluxes_) values += level.capacity();
  return plan_.bytes() + values * sizeof(Real);
}

}  // namespace amrpic
