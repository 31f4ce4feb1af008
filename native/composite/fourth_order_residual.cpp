#include "composite/fourth_order_residual.hpp"

#include <algorithm>
#include <cmath>
#include <type_traits>

#include "base/fetch.hpp"
#include "base/lanes.hpp"
#include "composite/composite_kernels.hpp"

namespace amrpic {

namespace {

constexpr int layers = FourthOrderGhosts::layers;

using fourth_order::across;

/// f - L phi of cells of equal size.
struct Formula {
  Equation equation;
  Background background;
  bool in_differences;  ///< see `is_nearly_free`

  /// `x`, `y`, `z`: what the cells in line along each axis add, see `across`, or their differences to this one.
  template <bool differences>
  Real find(Real rho, Real c, Real x, Real y, Real z) const {
    Real const f = background.right_hand_side(rho);
    if constexpr (differences)
      return f - fused(-equation.shift, c, weighted_sum(equation.weight, x, y, z));
    else
      return f - fourth_order::laplacian(equation, c, x, y, z);
  }
};

/// Rows of cells in line along y or z: two below, one below, one above, two above.
using Rows = std::array<Real const*, 4>;

/// f - L phi of a row between its ghosts, of which two stand before `c` and two behind.
void run(Formula const& formula, int count, Real const* c, Rows const& y, Rows const& z, Real const* __restrict rho,
         Real* __restrict out) {
  Real const *const ymm = y[0], *const ym = y[1], *const yp = y[2], *const ypp = y[3];
  Real const *const zmm = z[0], *const zm = z[1], *const zp = z[2], *const zpp = z[3];
  Formula const f = formula;
  fetch<Use::read>(rho + page<Real>, count);
  fetch<Use::read>(zpp + page<Real>, count);
  auto const find = [&](auto differences) {
    for (int i = 0; i < count; ++i) {
      auto const pair = [differences, here = c[i]](Real below, Real above) {
        return differences() ? (below - here) + (above - here) : below + above;
      };
      out[i] = f.find<differences()>(rho[i], c[i], across(pair(c[i - 1], c[i + 1]), pair(c[i - 2], c[i + 2])),
                                     across(pair(ym[i], yp[i]), pair(ymm[i], ypp[i])),
                                     across(pair(zm[i], zp[i]), pair(zmm[i], zpp[i])));
    }
  };
  f.in_differences ? find(std::true_type()) : find(std::false_type());
}

}  // namespace

FourthOrderResidual::FourthOrderResidual(CompositeMesh& mesh, FourthOrderGhosts& ghosts)
    : CompositeResidual(mesh), ghosts_(ghosts), zeros_(mesh.largest_row()) {
  for (auto& line : lines_) line.resize(mesh.largest_row() + 2 * layers);
}

bool FourthOrderResidual::has_wall(int l, int b) const {
  auto const& faces = mesh_.plan(l, b).faces;
  return std::any_of(faces.begin(), faces.end(), [](FacePlan const& face) { return face.wall >= 0; });
}

void FourthOrderResidual::residual_plane(int l, int b, int k, Source const& source, Field const& phi) {
  plane_of(l, b, k, source, phi.level(l).data() + mesh_.offset(l, b));
}

/// The rows of plane k of a box, or of a plane of ghosts beyond it. `cells`: of the box, null where they are zero.
FourthOrderResidual::RowsOfPlane FourthOrderResidual::rows_of(Box const& own, int k, Real const* cells) const {
  std::ptrdiff_t const nx = own.extent(0), plane = nx * own.extent(1);
  int const nz = own.extent(2);
  if (k < 0) return {ghosts_.ghosts(2, 0, -k - 1), nx};
  if (k >= nz) return {ghosts_.ghosts(2, 1, k - nz), nx};
  return cells ? RowsOfPlane{cells + k * plane, nx} : RowsOfPlane{zeros_.data(), 0};
}

/// Bring a row of cells between its ghosts into a line; returns where the cells begin. Vectors read across what is
/// stored here, so it is done a row ahead.
Real const* FourthOrderResidual::fill_line(Box const& own, int j, int k, Real const* row) {
  int const nx = own.extent(0), end = j + k * own.extent(1);
  Real* const line = lines_[std::size_t(j) % lines_.size()].data() + layers;
  int i = 0;
  for (; i + lane_count <= nx; i += lane_count) store(line + i, load<Lanes>(row + i));
  for (; i < nx; ++i) line[i] = row[i];
  for (int layer = 0; layer < layers; ++layer) {
    line[-1 - layer] = ghosts_.ghosts(0, 0, layer)[end];
    line[nx + layer] = ghosts_.ghosts(0, 1, layer)[end];
  }
  return line;
}

/// f - L phi of a plane of cells of a box whose ghosts are at hand, into `plane_`. `cells`: of the box, null where they
/// are zero.
void FourthOrderResidual::plane_of(int l, int b, int k, Source const& source, Real const* cells) {
  Box const& own = mesh_.box(l, b);
  int const nx = own.extent(0), ny = own.extent(1);
  std::ptrdiff_t const plane = std::ptrdiff_t(nx) * ny;
  Real const* const rho = source.rho.level(l).data() + mesh_.offset(l, b) + k * plane;
  Formula const formula{mesh_.equation(l), source.background, mesh_.is_nearly_free(l)};
  RowsOfPlane const here = rows_of(own, k, cells);
  std::array<RowsOfPlane, 4> const beside{rows_of(own, k - 2, cells), rows_of(own, k - 1, cells),
                                          rows_of(own, k + 1, cells), rows_of(own, k + 2, cells)};
  auto const row = [&](int j) {
    if (j < 0) return ghosts_.ghosts(1, 0, -j - 1) + std::ptrdiff_t(k) * nx;
    return j < ny ? here.row(j) : ghosts_.ghosts(1, 1, j - ny) + std::ptrdiff_t(k) * nx;
  };
  std::array<Real const*, 2 * layers + 1> y{nullptr, row(-2), row(-1), row(0), row(1)};
  Real const* line = fill_line(own, 0, k, y[3]);
  for (int j = 0; j < ny; ++j) {
    y = {y[1], y[2], y[3], y[4], row(j + 2)};
    Real const* const next = j + 1 < ny ? fill_line(own, j + 1, k, y[3]) : nullptr;
    run(formula, nx, line, {y[0], y[1], y[3], y[4]},
        {beside[0].row(j), beside[1].row(j), beside[2].row(j), beside[3].row(j)}, rho + std::ptrdiff_t(j) * nx,
        plane_.data() + std::ptrdiff_t(j) * nx);
    line = next;
  }
  auto const from = [&](int axis, Index3 const& cell) {
    if (axis == 2) return rows_of(own, cell[2], cells).row(cell[1]) + cell[0];
    if (axis == 1 || (cell[0] >= 0 && cell[0] < nx)) return row(cell[1]) + cell[0];
    return ghosts_.ghosts(0, cell[0] < 0 ? 0 : 1, cell[0] < 0 ? -cell[0] - 1 : cell[0] - nx) + cell[1] + k * ny;
  };
  ghosts_.for_each_refined(l, b, k, from, [&](int axis, Index3 const& cell, int count, auto const& excess) {
    Real const weight = formula.equation.weight[axis];
    Real* __restrict const out = plane_.data() + cell[0] + std::ptrdiff_t(cell[1]) * nx;
    for (int x = 0; x < count; ++x) out[x] -= weight * excess(x);
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
  Index3 const pitch = own.strides();
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
  std::ptrdiff_t const cells = mesh_.box(l, b).stride(2);
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
  std::ptrdiff_t const cells = mesh_.box(l, b).stride(2);
  Real const diagonal = fourth_order::diagonal(mesh_.equation(l));
  Real const* const values = phi.level(l).data() + mesh_.offset(l, b) + k * cells;
  for (std::ptrdiff_t i = 0; i < cells; ++i) plane_[std::size_t(i)] = diagonal * values[i];
  mesh_.clear_covered(l, b, k, plane_.data());
}

}  // namespace amrpic
