#include "composite/fourth_order_ghosts.hpp"

#include <algorithm>
#include <limits>

#include "base/fetch.hpp"

namespace amrpic {

using fourth_order::MeansBlock;

namespace {

/// Of a row of fine cells in front of coarser ones: the ghosts of both layers, and the differences between the first
/// ghost and the cell, from coarse means over their faces, of the second layer zero unless it serves, and fine means.
void run_in_front(fourth_order::InterfaceGhosts const& ghosts, int count, std::array<Real const*, 2> const& coarse,
                  std::array<Real const*, 3> const& fine, Real* __restrict near, Real* __restrict far,
                  Real* __restrict difference) {
  Real const *const c0 = coarse[0], *const c1 = coarse[1], *const f0 = fine[0], *const f1 = fine[1],
                    *const f2 = fine[2];
  auto const [w, of_far] = ghosts.layer;
  for (int x = 0; x < count; ++x) {
    near[x] = w.coarse[0] * c0[x] + w.coarse[1] * c1[x] + w.fine[0] * f0[x] + w.fine[1] * f1[x] + w.fine[2] * f2[x];
    far[x] = of_far.coarse[0] * c0[x] + of_far.coarse[1] * c1[x] + of_far.fine[0] * f0[x] + of_far.fine[1] * f1[x] +
             of_far.fine[2] * f2[x];
    difference[x] = fourth_order::difference(far[x], near[x], f0[x], f1[x]);
  }
}

}  // namespace

FourthOrderGhosts::FourthOrderGhosts(CompositeMesh& mesh) : mesh_(mesh), plan_(mesh), fluxes_(mesh) {
  for (int l = 0; l < mesh_.levels(); ++l) {
    wall_ghosts_.emplace_back();
    for (int f = 0; f < 6; ++f) {
      Boundary const kind = mesh_.hierarchy().domain().boundary[std::size_t(f / 2)][std::size_t(f % 2)];
      for (int cells = 1; cells <= fourth_order::wall_cells; ++cells)
        wall_ghosts_.back()[std::size_t(f)][std::size_t(cells)] =
            fourth_order::make_wall_ghosts(kind, mesh_.level(l).spacing()[std::size_t(f / 2)], cells);
    }
  }
  for (int coarse = 1; coarse <= fourth_order::coarse_cells; ++coarse)
    for (int fine = 2; fine <= fourth_order::fine_cells; ++fine)
      interface_ghosts_[std::size_t(coarse)][std::size_t(fine)] = fourth_order::make_interface_ghosts(coarse, fine);
  for (int size = 1; size <= MeansBlock::most; ++size)
    for (int back = 0; back < size; ++back)
      half_weights_[std::size_t(size)][std::size_t(back)] = fourth_order::make_half_weights(-back, size);
  std::size_t const row = mesh_.largest_row(), coarse_row = row / 2 + 2 + 2 * FourthOrderPlan::margin;
  for (int n = 0; n < layers; ++n) {
    for (int f = 0; f < 6; ++f) ghosts_[std::size_t(f)][std::size_t(n)].resize(mesh_.largest_face(f / 2));
    coarse_[std::size_t(n)].resize(mesh_.levels() > 1 ? coarse_row * coarse_row : 0);
    star_[std::size_t(n)].resize(2 * row);
  }
  columns_.resize(coarse_row);
  differences_.resize(row);
  for (auto& line : lines_) line.resize(row);
  line_.resize(row + 2 * layers);
}

void FourthOrderGhosts::visit(Field const& phi, std::vector<Walls> const* walls, Ends ends, FullyCovered fully_covered,
                              std::function<void(int, int)> const& f) {
  plan_.cells.start([&](int purpose, Read const& read, Real* out) {
    mesh_.pack_cells(phi, FourthOrderPlan::level_of(purpose), read, out);
  });
  zero_ = false;
  mesh_.visit(
      plan_.cells, fully_covered, [&](int l, int b) { return plan_.is_remote(l, b) || mesh_.plan(l, b).remote; },
      [&](int l) {
        if (mesh_.hierarchy().has_finer(l) && ends != Ends::nothing) fluxes_.finish(l);
      },
      [&](int l, int b) {
        fill(l, b, phi, walls ? &(*walls)[std::size_t(l)] : nullptr, ends);
        f(l, b);
      },
      [&](int l) {
        if (l > 0 && ends != Ends::nothing) fluxes_.send(l);
      });
  fluxes_.settle();
}

void FourthOrderGhosts::fill(int l, int b, Field const& phi, Walls const* walls, Ends ends) {
  constexpr Real nothing = std::numeric_limits<Real>::quiet_NaN();
  for (int f = 0; f < 6 && ends != Ends::faces; ++f) {  // of the level first: others may take them
    int const pitch = mesh_.box(l, b).extent(tangential_axes(f / 2)[0]);
    auto const& face = plan_.face(l, b, f);
    for (int n = 0; n < layers; ++n) {
      auto& layer = ghosts_[std::size_t(f)][std::size_t(n)];
      if (ends == Ends::nothing) std::fill(layer.begin(), layer.end(), nothing);
      for (int r = face.neighbours[std::size_t(n)].first; r < face.neighbours[std::size_t(n)].last; ++r)
        plan_.level(l).rectangles[std::size_t(r)].copy(phi.level(l).data(), plan_.cells.values(), layer.data(), pitch);
    }
  }
  for (int f = 0; f < 6 && ends != Ends::nothing; ++f) {
    if (ends == Ends::faces) {
      if (plan_.face(l, b, f).blocks >= 0) fill_faces(l, b, f / 2, f % 2, phi);
      continue;
    }
    if (int const wall = mesh_.plan(l, b).faces[std::size_t(f)].wall; wall >= 0) {
      Real const* const cells = phi.level(l).data() + mesh_.offset(l, b);
      fill_wall(l, b, f / 2, f % 2, ends, cells, *walls, wall);
      if (ends == Ends::of_field && walls->faces[std::size_t(wall)].kind == Boundary::dirichlet)
        extrapolate(l, b, f / 2, f % 2, cells);
    }
    if (plan_.face(l, b, f).blocks >= 0) fill_interface(l, b, f / 2, f % 2, phi);
  }
}

void FourthOrderGhosts::visit_zero(int l, int b, Walls const& walls) {
  zero_ = true;
  for (int f = 0; f < 6; ++f) {
    for (auto& layer : ghosts_[std::size_t(f)]) std::fill(layer.begin(), layer.end(), 0.0);
    int const wall = mesh_.plan(l, b).faces[std::size_t(f)].wall, axis = f / 2, side = f % 2;
    if (wall < 0 || fill_open_wall(l, b, axis, side, walls, wall)) continue;
    auto const [u, v] = tangential_axes(axis);
    Box const& own = mesh_.box(l, b);
    Real const* datum = walls.datum.data() + wall;
    bool const all_inside = own.extent(axis) >= fourth_order::wall_cells;
    auto const* ghosts = &wall_ghosts(l, axis, side, fourth_order::wall_cells);
    std::size_t out = 0;
    for (int y = 0; y < own.extent(v); ++y)
      for (int x = 0; x < own.extent(u); ++x, ++out) {
        if (!all_inside) ghosts = &wall_ghosts(l, axis, side, cells_inside(l, b, axis, side, x, y));
        for (std::size_t n = 0; n < layers; ++n) ghosts_[std::size_t(f)][n][out] = ghosts->layer[n].datum * datum[out];
      }
  }
}

std::array<Real const*, 2 * FourthOrderGhosts::layers + 1> FourthOrderGhosts::rows_in_line(Box const& own,
                                                                                           Real const* phi, int axis,
                                                                                           int j, int k) {
  std::ptrdiff_t const nx = own.extent(0), ny = own.extent(1);
  Real const* row = phi + nx * (j + ny * k);
  std::array<Real const*, 2 * layers + 1> out;
  if (axis == 0) {
    std::copy_n(row, nx, line_.data() + layers);
    row = line_.data() + layers;
    for (int n = 0; n < layers; ++n) {
      line_[std::size_t(layers - 1 - n)] = ghosts(0, 0, n)[j + ny * k];
      line_[std::size_t(layers + nx + n)] = ghosts(0, 1, n)[j + ny * k];
    }
  }
  for (int n = -layers; n <= layers; ++n) {
    int const at = (axis == 1 ? j : k) + n, end = own.extent(axis);
    bool const inside = axis == 0 || (at >= 0 && at < end);
    out[std::size_t(layers + n)] =
        inside ? row + n * own.stride(axis)
               : ghosts(axis, at < 0 ? 0 : 1, at < 0 ? -at - 1 : at - end) + nx * (axis == 1 ? k : j);
  }
  return out;
}

int FourthOrderGhosts::cells_inside(int l, int b, int axis, int side, int u, int v, int most) const {
  int const extent = mesh_.box(l, b).extent(axis);
  if (extent >= most) return most;
  auto const& opposite = mesh_.plan(l, b).faces[std::size_t(2 * axis + 1 - side)];
  if (opposite.wall >= 0) return extent;
  if (opposite.interface >= 0) {
    Interface const& i = mesh_.plan(l).interfaces[std::size_t(opposite.interface)];
    int const x = u / 2 - i.u, y = v / 2 - i.v;
    bool const ends =
        x >= 0 && x < i.nu && y >= 0 && y < i.nv && mesh_.plan(l).fits[std::size_t(i.fits + x + y * i.nu)] != no_fit;
    if (ends) return extent;
  }
  return std::min(extent + layers, most);
}

/// Of a row of the cells of a box at one of its faces, from (u, v) on, the first of each in line inwards, the second,
/// and so on, side by side: in the box, or copied to `lines_`.
std::array<Real const*, fourth_order::wall_cells> FourthOrderGhosts::cells_at(Box const& own, Real const* phi, int axis,
                                                                              int side, int u, int v, int count) {
  auto const [along, across] = tangential_axes(axis);
  Index3 const pitch = own.strides();
  std::ptrdiff_t const inward = side == 0 ? pitch[axis] : -pitch[axis];
  Real const* const first = phi + (side == 0 ? 0 : std::ptrdiff_t(own.extent(axis) - 1) * pitch[axis]) +
                            std::ptrdiff_t(u) * pitch[along] + std::ptrdiff_t(v) * pitch[across];
  std::array<Real const*, fourth_order::wall_cells> out;
  for (int n = 0; n < fourth_order::wall_cells; ++n) {
    Real const* const from = first + n * inward;
    Real* const to = lines_[std::size_t(n)].data();
    out[std::size_t(n)] = axis == 0 ? to : from;
  }
  if (axis > 0) return out;
  for (int x = 0; x < count; ++x) {
    Real const* const cell = first + std::ptrdiff_t(x) * pitch[along];
    fetch<Use::read>(cell + pitch[across], 1);  // each lies on a page of its own
    for (int n = 0; n < fourth_order::wall_cells; ++n) lines_[std::size_t(n)][std::size_t(x)] = cell[n * inward];
  }
  return out;
}

/// At an open wall the ghost values are the data of the wall and do not depend on the interior. `first`: number of the
/// box's first face there.
bool FourthOrderGhosts::fill_open_wall(int l, int b, int axis, int side, Walls const& walls, int first) {
  if (walls.faces[std::size_t(first)].kind != Boundary::open) return false;
  auto const [u, v] = tangential_axes(axis);
  std::ptrdiff_t const count = std::ptrdiff_t(mesh_.box(l, b).extent(u)) * mesh_.box(l, b).extent(v);
  auto& ghosts = ghosts_[std::size_t(2 * axis + side)];
  std::copy_n(walls.datum.data() + first, count, ghosts[0].data());
  std::copy_n(walls.second.data() + first, count, ghosts[1].data());
  return true;
}

void FourthOrderGhosts::fill_wall(int l, int b, int axis, int side, Ends ends, Real const* phi, Walls const& walls,
                                  int first) {
  if (fill_open_wall(l, b, axis, side, walls, first)) return;
  Real const* const data = walls.datum.data() + first;
  Box const& own = mesh_.box(l, b);
  auto const [u, v] = tangential_axes(axis);
  auto& ghosts = ghosts_[std::size_t(2 * axis + side)];
  auto const weights = [&](int cells) -> fourth_order::WallGhosts const& {
    return ends == Ends::of_field ? polynomial_at_wall(l, axis, side, cells) : wall_ghosts(l, axis, side, cells);
  };
  if (own.extent(axis) >= fourth_order::wall_cells) {  // all of them lie in the box
    auto const& w = weights(fourth_order::wall_cells);
    int const nu = own.extent(u);
    for (int y = 0; y < own.extent(v); ++y) {
      auto const line = cells_at(own, phi, axis, side, 0, y, nu);
      std::ptrdiff_t const first_out = std::ptrdiff_t(y) * nu;
      for (std::size_t n = 0; n < layers; ++n) {
        auto const layer = w.layer[n];
        Real const* const given = data + first_out;
        Real* __restrict const out = ghosts[n].data() + first_out;
        for (int x = 0; x < nu; ++x) out[x] = layer({line[0][x], line[1][x], line[2][x], line[3][x]}, given[x]);
      }
    }
    return;
  }
  Index3 cell{0, 0, 0};
  std::size_t out = 0;
  for (int y = 0; y < own.extent(v); ++y)
    for (int x = 0; x < own.extent(u); ++x, ++out) {
      cell[u] = x, cell[v] = y;
      int const cells = cells_inside(l, b, axis, side, x, y);
      std::array<Real, fourth_order::wall_cells> inside{};
      for (int n = 0; n < cells; ++n) {
        cell[axis] = side == 0 ? n : own.extent(axis) - 1 - n;
        inside[std::size_t(n)] = value(own, phi, axis, cell);
      }
      for (std::size_t n = 0; n < layers; ++n) ghosts[n][out] = weights(cells).layer[n](inside, data[out]);
    }
}

/// Replace the ghosts behind a wall by what the cells before it make of them, where the level has enough of these.
///
/// The flux through a Dirichlet wall is of third order. So the potential in the cells next to it has an error of h^4
/// that hardly changes from cell to cell: their difference to the wall's potential, over h, has one of h^3, those
/// between the cells a smaller one.
void FourthOrderGhosts::extrapolate(int l, int b, int axis, int side, Real const* phi) {
  constexpr int count = fourth_order::extrapolation_cells;
  Box const& own = mesh_.box(l, b);
  auto const [u, v] = tangential_axes(axis);
  Index3 cell{0, 0, 0};
  std::size_t out = 0;
  for (cell[v] = 0; cell[v] < own.extent(v); ++cell[v])
    for (cell[u] = 0; cell[u] < own.extent(u); ++cell[u], ++out) {
      if (cells_inside(l, b, axis, side, cell[u], cell[v], count) < count) continue;
      std::array<Real, layers> sum{};
      for (int n = 0; n < count; ++n) {
        cell[axis] = side == 0 ? n : own.extent(axis) - 1 - n;
        Real const inside = value(own, phi, axis, cell);
        for (std::size_t layer = 0; layer < layers; ++layer)
          sum[layer] += extrapolation_[layer][std::size_t(n)] * inside;
      }
      for (std::size_t layer = 0; layer < layers; ++layer)
        ghosts_[std::size_t(2 * axis + side)][layer][out] = sum[layer];
    }
}

/// Means of a layer of coarse cells over the faces of the fine cells in front of them, of a row of these: two rows.
void FourthOrderGhosts::fit_row(int layer, FourthOrderPlan::OfCell const* blocks, FitNumber const* fits, int count,
                                Real const* coarse, std::ptrdiff_t pitch) {
  auto const is_central = [&](int m) { return fits[m] != no_fit && blocks[m][std::size_t(layer)].is_central(); };
  for (int m = 0; m < count;) {
    int end = m;
    while (end < count && is_central(end)) ++end;
    if (end > m) fit_central(layer, m, end, count, coarse, pitch);
    for (m = end; m < count && !is_central(m); ++m)
      if (fits[m] != no_fit && blocks[m][std::size_t(layer)].size > 0)
        fit_cell(layer, blocks[m][std::size_t(layer)], m, count, coarse, pitch);
  }
}

/// Of the cells [begin, end), all with the block around them.
void FourthOrderGhosts::fit_central(int layer, int begin, int end, int count, Real const* coarse,
                                    std::ptrdiff_t pitch) {
  constexpr int size = MeansBlock::most, middle = size / 2;
  auto const& weights = half_weights_[size][middle];
  Real* const columns = columns_.data();
  for (std::size_t upper = 0; upper < 2; ++upper) {
    auto const& along_v = weights[upper];
    Real const* const rows = coarse - middle * (1 + pitch);
    int const width = end - begin + 2 * middle;
    for (int x = 0; x < width; ++x) {
      Real const* const c = rows + begin + x;
      columns[x] = along_v[0] * c[0] + along_v[1] * c[pitch] + along_v[2] * c[2 * pitch] + along_v[3] * c[3 * pitch] +
                   along_v[4] * c[4 * pitch];
    }
    Real* const star = star_[std::size_t(layer)].data() + upper * 2 * std::size_t(count) + 2 * std::size_t(begin);
    for (int x = 0; x < end - begin; ++x)
      for (std::size_t half = 0; half < 2; ++half) {
        auto const& w = weights[half];
        star[2 * x + int(half)] = w[0] * columns[x] + w[1] * columns[x + 1] + w[2] * columns[x + 2] +
                                  w[3] * columns[x + 3] + w[4] * columns[x + 4];
      }
  }
}

/// Of one cell, with any block.
void FourthOrderGhosts::fit_cell(int layer, MeansBlock const& block, int m, int count, Real const* coarse,
                                 std::ptrdiff_t pitch) {
  auto const& along_u = half_weights_[std::size_t(block.size)][std::size_t(-block.u)];
  auto const& along_v = half_weights_[std::size_t(block.size)][std::size_t(-block.v)];
  Real const* const first = coarse + m + block.u + pitch * block.v;
  std::array<std::array<Real, 2>, 2> sum{};  // [upper half along v][along u]
  for (int j = 0; j < block.size; ++j) {
    Real const* const row = first + pitch * j;
    std::array<Real, 2> of_row{};
    for (int i = 0; i < block.size; ++i)
      for (std::size_t half = 0; half < 2; ++half) of_row[half] += along_u[half][std::size_t(i)] * row[i];
    for (std::size_t upper = 0; upper < 2; ++upper)
      for (std::size_t half = 0; half < 2; ++half) sum[upper][half] += along_v[upper][std::size_t(j)] * of_row[half];
  }
  for (std::size_t upper = 0; upper < 2; ++upper)
    for (std::size_t half = 0; half < 2; ++half)
      star_[std::size_t(layer)][upper * 2 * std::size_t(count) + 2 * std::size_t(m) + half] = sum[upper][half];
}

/// Two layers of coarse cells behind a face, into `coarse_`.
void FourthOrderGhosts::read_coarse(int l, int b, int f, Field const& values) {
  auto const& face = plan_.face(l, b, f);
  for (std::size_t n = 0; n < layers; ++n)
    for (int r = face.coarse[n].first; r < face.coarse[n].last; ++r)
      plan_.level(l).rectangles[std::size_t(r)].copy(values.level(l - 1).data(), plan_.cells.values(),
                                                     coarse_[n].data(), face.nu + 2 * FourthOrderPlan::margin);
}

/// Values on the faces of fine cells in front of coarser ones, linear between the two centres, of which the coarse one
/// is twice as far away; their sums over the coarse faces are left for the coarser cells.
void FourthOrderGhosts::fill_faces(int l, int b, int axis, int side, Field const& values) {
  std::size_t const f = std::size_t(2 * axis + side);
  Interface const& i = mesh_.plan(l).interfaces[std::size_t(mesh_.plan(l, b).faces[f].interface)];
  constexpr int margin = FourthOrderPlan::margin;
  read_coarse(l, b, int(f), values);
  for (int row = 0; row < i.nv; ++row) std::fill_n(fluxes_.row(l, i, row), i.nu, 0.0);
  Box const& own = mesh_.box(l, b);
  int const u = tangential_axes(axis)[0];
  Real const* const cells = values.level(l).data() + mesh_.offset(l, b);
  std::ptrdiff_t const pitch = plan_.face(l, b, int(f)).nu + 2 * margin;
  for (int y = 0; y < 2 * i.nv; ++y) {
    FitNumber const* const fits = mesh_.plan(l).fits.data() + i.fits + std::ptrdiff_t(y / 2) * i.nu;
    Real const* const coarse = coarse_[0].data() + margin + i.u + (margin + i.v + y / 2) * pitch;
    Real* const flux = fluxes_.row(l, i, y / 2);
    Real const* const fine = cells_at(own, cells, axis, side, 2 * i.u, 2 * i.v + y, 2 * i.nu)[0];
    Real* const on_face = ghosts_[f][0].data() + 2 * i.u + std::ptrdiff_t(2 * i.v + y) * own.extent(u);
    for (int x = 0; x < 2 * i.nu; ++x) {
      on_face[x] = fits[x / 2] == no_fit ? 0 : (2 * fine[x] + coarse[x / 2]) / 3;
      flux[x / 2] += on_face[x];
    }
  }
}

/// Ghosts in front of coarser cells, and what the four ghosts of each coarse face leave for the coarser cell behind it:
/// the sum of the differences across them, inwards.
void FourthOrderGhosts::fill_interface(int l, int b, int axis, int side, Field const& phi) {
  std::size_t const f = std::size_t(2 * axis + side);
  Interface const& i = mesh_.plan(l).interfaces[std::size_t(mesh_.plan(l, b).faces[f].interface)];
  auto const& face = plan_.face(l, b, int(f));
  std::ptrdiff_t const coarse_pitch = face.nu + 2 * FourthOrderPlan::margin;
  read_coarse(l, b, int(f), phi);

  Real const* const cells = phi.level(l).data() + mesh_.offset(l, b);
  for (int row = 0; row < i.nv; ++row) {
    FitNumber const* const fits = mesh_.plan(l).fits.data() + i.fits + std::ptrdiff_t(row) * i.nu;
    auto const* const blocks = plan_.level(l).blocks.data() + face.blocks + i.u + std::ptrdiff_t(i.v + row) * face.nu;
    Real* const flux = fluxes_.row(l, i, row);
    for (int n = 0; n < layers; ++n)
      fit_row(n, blocks, fits, i.nu,
              coarse_[std::size_t(n)].data() + FourthOrderPlan::margin + i.u +
                  (FourthOrderPlan::margin + i.v + row) * coarse_pitch,
              coarse_pitch);
    // A second layer whose means are worse than the first's would only spoil the polynomial along the normal.
    auto const is_deep = [&](int m) {
      return blocks[m][1].size >= std::min<int>(blocks[m][0].size, MeansBlock::most - 1);
    };
    for (int m = 0; m < i.nu;) {
      if (fits[m] == no_fit) {
        ++m;
        continue;
      }
      int end = m + 1;
      while (end < i.nu && fits[end] != no_fit && is_deep(end) == is_deep(m)) ++end;
      fill_in_front(l, b, axis, side, i, row, m, end, is_deep(m), cells, flux);
      m = end;
    }
  }
}

/// The ghosts of the coarse cells [begin, end) of a row behind an interface, and what they leave for these. `deep`: of
/// both layers of coarse means.
void FourthOrderGhosts::fill_in_front(int l, int b, int axis, int side, Interface const& i, int row, int begin, int end,
                                      bool deep, Real const* cells, Real* flux) {
  Box const& own = mesh_.box(l, b);
  auto const [u, v] = tangential_axes(axis);
  auto& ghosts = ghosts_[std::size_t(2 * axis + side)];
  std::fill(flux + begin, flux + end, 0.0);
  bool const all_inside = own.extent(axis) >= fourth_order::wall_cells;  // else cells in line inwards need not
  for (int half = 0; half < 2; ++half) {
    int const first_u = 2 * (i.u + begin), row_v = 2 * (i.v + row) + half, count = 2 * (end - begin);
    std::ptrdiff_t const at = first_u + std::ptrdiff_t(row_v) * own.extent(u);
    Real *const near = ghosts[0].data() + at, *const far = ghosts[1].data() + at, *const left = differences_.data();
    std::size_t const of_half = std::size_t(half) * 2 * std::size_t(i.nu) + 2 * std::size_t(begin);
    Real const *const star = star_[0].data() + of_half, *const second = star_[deep ? 1 : 0].data() + of_half;
    auto const set = [=](int cells_inside, int x, int n, Real const* f0, Real const* f1, Real const* f2) {
      run_in_front(interface_ghosts_[deep ? 2 : 1][std::size_t(cells_inside)], n, {star + x, second + x}, {f0, f1, f2},
                   near + x, far + x, left + x);
    };
    if (all_inside) {
      auto const line = cells_at(own, cells, axis, side, first_u, row_v, count);
      set(fourth_order::fine_cells, 0, count, line[0], line[1], line[2]);
    }
    for (int x = 0; !all_inside && x < count; ++x) {
      Index3 cell{0, 0, 0};
      cell[u] = first_u + x, cell[v] = row_v;
      int const inside = std::min(cells_inside(l, b, axis, side, cell[u], cell[v]), fourth_order::fine_cells);
      std::array<Real, fourth_order::fine_cells> fine{};
      for (int n = 0; n < inside; ++n) {
        cell[axis] = side == 0 ? n : own.extent(axis) - 1 - n;
        fine[std::size_t(n)] = value(own, cells, axis, cell);
      }
      set(inside, x, 1, &fine[0], &fine[1], &fine[2]);
    }
    for (int m = begin; m < end; ++m) flux[m] += left[2 * (m - begin)] + left[2 * (m - begin) + 1];
  }
}

std::size_t FourthOrderGhosts::bytes() const {
  std::size_t values =
      columns_.capacity() + differences_.capacity() + line_.capacity() + lines_.size() * lines_[0].capacity();
  for (int n = 0; n < layers; ++n) {
    values += coarse_[std::size_t(n)].capacity() + star_[std::size_t(n)].capacity();
    for (auto const& face : ghosts_) values += face[std::size_t(n)].capacity();
  }
  return plan_.bytes() + fluxes_.bytes() + values * sizeof(Real);
}

}  // namespace amrpic
