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

/// Where the cells one and two away along y and z lie of a run of cells that are contiguous in memory: below, above.
struct InLine {
  std::array<Real const*, 4> y, z;  ///< two below, one below, one above, two above
};

/// f - L phi of the cells [first, last) of a run; the ends of rows take what memory holds beside them along x, and are
/// put right afterwards.
void run(Formula const& formula, std::ptrdiff_t first, std::ptrdiff_t last, Real const* __restrict c, InLine const& n,
         Real const* __restrict rho, Real* __restrict out) {
  Real const *const ym = n.y[1], *const yp = n.y[2], *const ymm = n.y[0], *const ypp = n.y[3];
  Real const *const zm = n.z[1], *const zp = n.z[2], *const zmm = n.z[0], *const zpp = n.z[3];
  Formula const f = formula;
  kernels::for_each_part(first, last, [&](std::ptrdiff_t begin, std::ptrdiff_t end) {
    fetch<Use::read>(rho + begin + page<Real>, end - begin);
    fetch<Use::read>(zpp + begin + page<Real>, end - begin);
    for (std::ptrdiff_t i = begin; i < end; ++i)
      out[i] = f(rho[i], c[i], c[i - 1] + c[i + 1], c[i - 2] + c[i + 2], ym[i] + yp[i], ymm[i] + ypp[i], zm[i] + zp[i],
                 zmm[i] + zpp[i]);
  });
}

}  // namespace

FourthOrderResidual::FourthOrderResidual(CompositeMesh& mesh, FourthOrderGhosts& ghosts)
    : CompositeResidual(mesh), ghosts_(ghosts) {
  std::size_t most = 0;
  mesh_.for_each_box([&](int l, int b) {
    if (has_wall(l, b) && !has_walls_alone(l, b)) most = std::max(most, std::size_t(mesh_.box(l, b).cells()));
  });
  if (most > 0) zeros_.assign(most + 2 * layers, 0.0);
}

bool FourthOrderResidual::has_wall(int l, int b) const {
  auto const& faces = mesh_.plan(l, b).faces;
  return std::any_of(faces.begin(), faces.end(), [](FacePlan const& face) { return face.wall >= 0; });
}

void FourthOrderResidual::residual_plane(int l, int b, int k, Source const& source, Field const& phi) {
  auto const& values = phi.level(l);
  plane_of(l, b, k, source, values.data() + mesh_.offset(l, b), values.data(), values.data() + values.size());
}

/// f - L phi of a plane of cells of a box whose ghosts are at hand, into `plane_`. Memory may be read between `begin`
/// and `end`.
void FourthOrderResidual::plane_of(int l, int b, int k, Source const& source, Real const* cells, Real const* begin,
                                   Real const* end) {
  Box const& own = mesh_.box(l, b);
  int const nx = own.extent(0), ny = own.extent(1), nz = own.extent(2);
  std::ptrdiff_t const plane = std::ptrdiff_t(nx) * ny;
  Real const* const rho = source.rho.level(l).data() + mesh_.offset(l, b) + k * plane;
  Formula const formula{mesh_.equation(l), source.background};
  Real const* const c = cells + k * plane;
  auto row_along_y = [&](int j) -> Real const* {
    if (j >= 0 && j < ny) return c + std::ptrdiff_t(j) * nx;
    return ghosts_.ghosts(1, j < 0 ? 0 : 1, j < 0 ? -j - 1 : j - ny) + std::ptrdiff_t(k) * nx;
  };
  auto plane_along_z = [&](int n) -> Real const* {
    if (n >= 0 && n < nz) return cells + n * plane;
    return ghosts_.ghosts(2, n < 0 ? 0 : 1, n < 0 ? -n - 1 : n - nz);
  };
  std::array<Real const*, 4> const z{plane_along_z(k - 2), plane_along_z(k - 1), plane_along_z(k + 1),
                                     plane_along_z(k + 2)};
  auto in_line = [&](int j) {
    std::ptrdiff_t const at = std::ptrdiff_t(j) * nx;
    return InLine{{row_along_y(j - 2), row_along_y(j - 1), row_along_y(j + 1), row_along_y(j + 2)},
                  {z[0] + at, z[1] + at, z[2] + at, z[3] + at}};
  };
  // Rows away from the first and last two lie side by side, as their neighbours do.
  auto sweep = [&](int first, int last) {
    std::ptrdiff_t const at = std::ptrdiff_t(first) * nx, count = std::ptrdiff_t(last - first) * nx;
    std::ptrdiff_t const from = std::max<std::ptrdiff_t>(0, layers - (c + at - begin));
    std::ptrdiff_t const to = std::min<std::ptrdiff_t>(count, end - (c + at) - layers);
    run(formula, from, to, c + at, in_line(first), rho + at, plane_.data() + at);
  };
  int const inner = std::max(layers, ny - layers);
  for (int j = 0; j < std::min(layers, ny); ++j) sweep(j, j + 1);
  if (inner > layers) sweep(layers, inner);
  for (int j = inner; j < ny; ++j) sweep(j, j + 1);
  for (int j = 0; j < ny; ++j) {
    std::ptrdiff_t const at = std::ptrdiff_t(j) * nx;
    std::ptrdiff_t const of_row = j + std::ptrdiff_t(k) * ny;
    InLine const n = in_line(j);
    Real const* const row = c + at;
    auto set = [&](int i, Real x_near, Real x_far) {
      plane_[std::size_t(at + i)] = formula(rho[at + i], row[i], x_near, x_far, n.y[1][i] + n.y[2][i],
                                            n.y[0][i] + n.y[3][i], n.z[1][i] + n.z[2][i], n.z[0][i] + n.z[3][i]);
    };
    std::array<Real, layers> const below{ghosts_.ghosts(0, 0, 0)[of_row], ghosts_.ghosts(0, 0, 1)[of_row]},
        above{ghosts_.ghosts(0, 1, 0)[of_row], ghosts_.ghosts(0, 1, 1)[of_row]};
    if (int const e = nx - 1; nx >= 2 * layers) {
      set(0, below[0] + row[1], below[1] + row[2]);
      set(1, row[0] + row[2], below[0] + row[3]);
      set(e - 1, row[e - 2] + row[e], row[e - 3] + above[0]);
      set(e, row[e - 1] + above[0], row[e - 2] + above[1]);
      continue;
    }
    auto along_x = [&](int i) {
      if (i >= 0 && i < nx) return row[i];
      return i < 0 ? below[std::size_t(-i - 1)] : above[std::size_t(i - nx)];
    };
    for (int i = 0; i < nx; ++i) set(i, along_x(i - 1) + along_x(i + 1), along_x(i - 2) + along_x(i + 2));
  }
  ghosts_.for_each_refined(l, b, k, cells, [&](std::ptrdiff_t at, int axis, Real excess) {
    plane_[std::size_t(at - k * plane)] -= formula.equation.weight[axis] * excess;
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
  plane_of(l, b, k, source, zeros_.data() + layers, zeros_.data(), zeros_.data() + zeros_.size());
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
