#include "matrixfree/fourth_order_residual.hpp"

#include <algorithm>
#include <cmath>

#include "base/fetch.hpp"
#include "matrixfree/composite_kernels.hpp"

namespace amrpic {

namespace {

constexpr int layers = FourthOrderGhosts::layers;

/// f - L phi of cells of equal size.
struct Formula {
  Equation equation;
  Background background;

  Real operator()(Real rho, Real c, Real x_near, Real x_far, Real y_near, Real y_far, Real z_near, Real z_far) const {
    return background.right_hand_side(rho) -
           fourth_order::laplacian(equation, c, {x_near, y_near, z_near}, {x_far, y_far, z_far});
  }
};

/// A row of cells between its ghosts, and those in line with it along y and z: two below, one below, one above, two
/// above.
struct Rows {
  Real const* own;
  std::array<Real const*, 4> y, z;
};

/// f - L phi of a row.
void run(Formula const& formula, int count, Rows const& rows, Real const* __restrict rho, Real* __restrict out) {
  Real const* const c = rows.own;
  Real const *const ymm = rows.y[0], *const ym = rows.y[1], *const yp = rows.y[2], *const ypp = rows.y[3];
  Real const *const zmm = rows.z[0], *const zm = rows.z[1], *const zp = rows.z[2], *const zpp = rows.z[3];
  Formula const f = formula;
  fetch<Use::read>(rho + page<Real>, count);
  for (int i = 0; i < count; ++i)
    out[i] = f(rho[i], c[i], c[i - 1] + c[i + 1], c[i - 2] + c[i + 2], ym[i] + yp[i], ymm[i] + ypp[i], zm[i] + zp[i],
               zmm[i] + zpp[i]);
}

}  // namespace

FourthOrderResidual::FourthOrderResidual(CompositeMesh& mesh, FourthOrderGhosts& ghosts)
    : CompositeResidual(mesh), ghosts_(ghosts) {
  std::size_t most = 0;
  mesh_.for_each_box([&](int l, int b) {
    Box const& own = mesh_.box(l, b);
    most = std::max(most, std::size_t(own.extent(0) + 2 * layers) * std::size_t(own.extent(1) + 2 * layers));
  });
  for (auto& plane : planes_) plane.resize(most);
}

bool FourthOrderResidual::has_wall(int l, int b) const {
  auto const& faces = mesh_.plan(l, b).faces;
  return std::any_of(faces.begin(), faces.end(), [](FacePlan const& face) { return face.wall >= 0; });
}

void FourthOrderResidual::residual_plane(int l, int b, int k, Source const& source, Field const& phi) {
  plane_of(l, b, k, source, phi.level(l).data() + mesh_.offset(l, b));
}

/// Bring plane n of a box into `planes_`, with the ghosts around it; of a plane of ghosts those in front of cells.
/// `cells`: of the box, null where they are zero.
void FourthOrderResidual::fill_plane(Box const& own, int n, Real const* cells) {
  int const nx = own.extent(0), ny = own.extent(1), nz = own.extent(2);
  std::ptrdiff_t const pitch = nx + 2 * layers;
  Real* const out = plane_around(own, n);
  auto const set_row = [&](int j, Real const* from) {
    from ? std::copy_n(from, nx, out + j * pitch) : std::fill_n(out + j * pitch, nx, Real(0));
  };
  if (n < 0 || n >= nz) {
    Real const* const from = ghosts_.ghosts(2, n < 0 ? 0 : 1, n < 0 ? -n - 1 : n - nz);
    for (int j = 0; j < ny; ++j) set_row(j, from + std::ptrdiff_t(j) * nx);
    return;
  }
  for (int j = 0; j < ny; ++j) set_row(j, cells ? cells + (std::ptrdiff_t(n) * ny + j) * nx : nullptr);
  for (int layer = 0; layer < layers; ++layer) {
    set_row(-1 - layer, ghosts_.ghosts(1, 0, layer) + std::ptrdiff_t(n) * nx);
    set_row(ny + layer, ghosts_.ghosts(1, 1, layer) + std::ptrdiff_t(n) * nx);
    Real const* const below = ghosts_.ghosts(0, 0, layer) + std::ptrdiff_t(n) * ny;
    Real const* const above = ghosts_.ghosts(0, 1, layer) + std::ptrdiff_t(n) * ny;
    for (int j = 0; j < ny; ++j) out[j * pitch - 1 - layer] = below[j], out[j * pitch + nx + layer] = above[j];
  }
}

/// f - L phi of a plane of cells of a box whose ghosts are at hand, into `plane_`; plane after plane, from the first
/// on. `cells`: of the box, null where they are zero.
void FourthOrderResidual::plane_of(int l, int b, int k, Source const& source, Real const* cells) {
  Box const& own = mesh_.box(l, b);
  std::ptrdiff_t const nx = own.extent(0), ny = own.extent(1), pitch = nx + 2 * layers;
  for (int n = k == 0 ? -layers : k + layers; n <= k + layers; ++n) fill_plane(own, n, cells);
  Real const* const rho = source.rho.level(l).data() + mesh_.offset(l, b) + k * nx * ny;
  Formula const formula{mesh_.equation(l), source.background};
  Real const* const c = plane_around(own, k);
  std::array<Real const*, 4> const z{plane_around(own, k - 2), plane_around(own, k - 1), plane_around(own, k + 1),
                                     plane_around(own, k + 2)};
  for (std::ptrdiff_t j = 0; j < ny; ++j) {
    std::ptrdiff_t const at = j * pitch;
    run(formula, int(nx),
        {c + at,
         {c + at - 2 * pitch, c + at - pitch, c + at + pitch, c + at + 2 * pitch},
         {z[0] + at, z[1] + at, z[2] + at, z[3] + at}},
        rho + j * nx, plane_.data() + j * nx);
  }
  auto const value = [&](Index3 const& cell) { return plane_around(own, cell[2])[cell[0] + cell[1] * pitch]; };
  ghosts_.for_each_refined(l, b, k, value, [&](std::ptrdiff_t at, int axis, Real excess) {
    plane_[std::size_t(at - k * nx * ny)] -= formula.equation.weight[axis] * excess;
  });
  mesh_.clear_covered(l, b, k, plane_.data());
}

/// Whether wall data reach no further than the first two cells of the box: it has these between any two ends of its
/// level, and no finer fluxes.
bool FourthOrderResidual::has_walls_alone(int l, int b) const {
  Box const& own = mesh_.box(l, b);
  auto const& refined = mesh_.plan(l, b).refined;
  return std::min({own.extent(0), own.extent(1), own.extent(2)}) >= 2 * layers && refined.first == refined.last;
}

/// `plane_` -= what the wall data add to the Laplacian in a plane of such a box, rounded as everywhere.
void FourthOrderResidual::subtract_walls(int l, int b, int k) {
  Box const& own = mesh_.box(l, b);
  Index3 const pitch = pitches(own);
  for (auto& of_axis : across_) of_axis.assign(std::size_t(pitch[2]), 0.0);
  for (int f = 0; f < 6; ++f) {
    if (mesh_.plan(l, b).faces[std::size_t(f)].wall < 0) continue;
    int const axis = f / 2, side = f % 2;
    Real const *const near = ghosts_.ghosts(axis, side, 0), *const far = ghosts_.ghosts(axis, side, 1);
    auto& out = across_[std::size_t(axis)];
    for (int n = 0; n < layers; ++n) {
      int const place = side == 0 ? n : own.extent(axis) - 1 - n;
      auto const add = [&](std::ptrdiff_t at, std::ptrdiff_t step, std::ptrdiff_t from, int count) {
        for (int x = 0; x < count; ++x)
          out[std::size_t(at + x * step)] = n == 0 ? fourth_order::across(near[from + x], far[from + x])
                                                   : fourth_order::across(Real(0), near[from + x]);
      };
      if (axis == 2 && k == place)
        add(0, 1, 0, pitch[2]);
      else if (axis < 2)  // a row of the face
        add(std::ptrdiff_t(place) * pitch[axis], pitch[1 - axis], std::ptrdiff_t(k) * own.extent(1 - axis),
            own.extent(1 - axis));
    }
  }
  Real3 const weight = mesh_.equation(l).weight;
  for (std::size_t i = 0; i < across_[0].size(); ++i)
    plane_[i] -= weighted_sum(weight, across_[0][i], across_[1][i], across_[2][i]);
}

void FourthOrderResidual::right_hand_side_plane(int l, int b, int k, Source const& source) {
  if (k == 0 && has_wall(l, b)) ghosts_.visit_zero(l, b, source.walls[std::size_t(l)]);
  if (!has_wall(l, b) || has_walls_alone(l, b)) {
    source_plane(l, b, k, source);
    if (has_wall(l, b)) subtract_walls(l, b, k);
    return mesh_.clear_covered(l, b, k, plane_.data());
  }
  plane_of(l, b, k, source, nullptr);
}

void FourthOrderResidual::term_sizes_plane(int l, int b, int k, Source const& source) {
  std::ptrdiff_t const cells = pitches(mesh_.box(l, b))[2];
  std::vector<Real> of_walls(std::size_t(cells), 0.0);
  if (has_wall(l, b)) {
    right_hand_side_plane(l, b, k, source);
    std::copy_n(plane_.begin(), cells, of_walls.begin());
    source_plane(l, b, k, source);
    for (std::ptrdiff_t i = 0; i < cells; ++i)
      of_walls[std::size_t(i)] = std::abs(plane_[std::size_t(i)] - of_walls[std::size_t(i)]);
  }
  source_sizes_plane(l, b, k, source);
  for (std::ptrdiff_t i = 0; i < cells; ++i) plane_[std::size_t(i)] += of_walls[std::size_t(i)];
  mesh_.clear_covered(l, b, k, plane_.data());
}

void FourthOrderResidual::diagonal_plane(int l, int b, int k, Field const& phi) {
  std::ptrdiff_t const cells = pitches(mesh_.box(l, b))[2];
  Real const diagonal = fourth_order::diagonal(mesh_.equation(l));
  Real const* const values = phi.level(l).data() + mesh_.offset(l, b) + k * cells;
  for (std::ptrdiff_t i = 0; i < cells; ++i) plane_[std::size_t(i)] = diagonal * values[i];
  mesh_.clear_covered(l, b, k, plane_.data());
}

}  // namespace amrpic
