#include "composite/fourth_order_field.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace amrpic {

namespace {

using Ends = FourthOrderGhosts::Ends;
using Rows = std::array<Real const*, 2 * FourthOrderGhosts::layers + 1>;  ///< of cells in line, the middle ones at [2]

Real central_difference(Real below, Real own, Real above) { return (below - own) + (above - own); }

/// The second difference about a place of a line, where at(n) is the value n cells further, not a number where the line
/// has none: one-sided at its ends, of four points or of three; zero where these do not exist.
template <class At>
Real second_difference(At&& at, bool four_points) {
  Real const own = at(0);
  Real const below = at(-1), above = at(1);
  if (!std::isnan(below) && !std::isnan(above)) return central_difference(below, own, above);
  for (int side : {-1, 1}) {
    Real const first = side < 0 ? below : above;
    if (std::isnan(first)) continue;
    Real const second = at(2 * side);
    if (std::isnan(second)) continue;
    Real const third = four_points ? at(3 * side) : std::numeric_limits<Real>::quiet_NaN();
    if (!std::isnan(third)) return 2 * own - 5 * first + 4 * second - third;
    return own - 2 * first + second;
  }
  return 0;
}

}  // namespace

/// Call f(place among the own cells of the level, count, rows in line along an axis) for the rows of a box under way.
template <class F>
void FourthOrderField::for_each_row_in_line(int l, int b, int axis, Field const& field, F&& f) {
  Box const& own = mesh_.box(l, b);
  std::ptrdiff_t place = mesh_.offset(l, b);
  Real const* const cells = field.level(l).data() + place;
  for (int k = 0; k < own.extent(2); ++k)
    for (int j = 0; j < own.extent(1); ++j, place += own.extent(0))
      f(place, own.extent(0), ghosts_.rows_in_line(own, cells, axis, j, k));
}

/// The sums of second differences along all axes in a box under way.
void FourthOrderField::second_differences(Box const& own, Real const* cells, bool four_points, Real* out) const {
  std::ptrdiff_t const nx = own.extent(0), plane = nx * own.extent(1);
  Index3 const end{own.extent(0) - 1, own.extent(1) - 1, own.extent(2) - 1};
  for (Index3 cell{0, 0, 0}; cell[2] <= end[2]; ++cell[2])
    for (cell[1] = 0; cell[1] <= end[1]; ++cell[1], cells += nx, out += nx) {
      auto const beside = [&](int axis, int side, std::ptrdiff_t step) {
        bool const inside = side == 0 ? cell[axis] > 0 : cell[axis] < end[axis];
        int const row = axis == 1 ? cell[2] : cell[1];
        return inside ? cells + (side == 0 ? -step : step) : ghosts_.ghosts(axis, side, 0) + row * nx;
      };
      Real const *const c = cells, *const ym = beside(1, 0, nx), *const yp = beside(1, 1, nx),
                        *const zm = beside(2, 0, plane), *const zp = beside(2, 1, plane);
      for (int i = 1; i < end[0]; ++i)
        out[i] = central_difference(c[i - 1], c[i], c[i + 1]) + central_difference(ym[i], c[i], yp[i]) +
                 central_difference(zm[i], c[i], zp[i]);
      out[0] = out[end[0]] = std::numeric_limits<Real>::quiet_NaN();
      bool some = false;
      for (int i = 1; i < end[0]; ++i) some |= out[i] != out[i];
      // Where a value beside a cell is not a number: at ends of what is known of the level, and of the box.
      int const line = cell[1] + cell[2] * own.extent(1), step = some ? 1 : std::max(end[0], 1);
      for (int i = 0; i <= end[0]; i += step) {
        if (!std::isnan(out[i]) || std::isnan(c[i])) continue;
        cell[0] = i;
        Real3 const below{i > 0 ? c[i - 1] : ghosts_.ghosts(0, 0, 0)[line], ym[i], zm[i]};
        Real3 const above{i < end[0] ? c[i + 1] : ghosts_.ghosts(0, 1, 0)[line], yp[i], zp[i]};
        out[i] = 0;
        for (int d = 0; d < 3; ++d) {
          if (!std::isnan(below[d]) && !std::isnan(above[d])) {
            out[i] += central_difference(below[d], c[i], above[d]);
            continue;
          }
          auto const at = ghosts_.in_line(own, c - cell[1] * nx - cell[2] * plane, d, cell);
          int const first = -cell[d] - FourthOrderGhosts::layers, last = end[d] - cell[d] + FourthOrderGhosts::layers;
          auto const known = [&](int n) {
            return n >= first && n <= last ? at(n) : std::numeric_limits<Real>::quiet_NaN();
          };
          out[i] += second_difference(known, four_points);
        }
      }
    }
}

/// field += factor * its second differences along all axes, level by level: only ghosts of the level's own cells are
/// read, and those of other ranks are at hand before the first level.
void FourthOrderField::add_second_differences(Field& field, Real factor, bool four_points) {
  std::size_t most = 0;
  for (int l = 0; l < mesh_.levels(); ++l) most = std::max(most, field.level(l).size());
  std::vector<Real> differences(most);
  int level = -1;
  auto const add = [&] {
    if (level < 0) return;
    Real* const values = field.level(level).data();
    for (std::size_t i = 0; i < field.level(level).size(); ++i) values[i] += factor * differences[i];
  };
  ghosts_.visit(field, nullptr, Ends::nothing, FullyCovered::visit, [&](int l, int b) {
    if (l != level) {
      add();
      level = l;
    }
    second_differences(mesh_.box(l, b), field.level(l).data() + mesh_.offset(l, b), four_points,
                       differences.data() + mesh_.offset(l, b));
  });
  add();
}

void FourthOrderField::to_points(Field const& means, Field& points) {
  for (int l = 0; l < mesh_.levels(); ++l)
    std::copy(means.level(l).begin(), means.level(l).end(), points.level(l).begin());
  add_second_differences(points, -fourth_order::mean_less_point, true);
}

void FourthOrderField::to_means(Field const& points, Field& means) {
  for (int l = 0; l < mesh_.levels(); ++l)
    std::copy(points.level(l).begin(), points.level(l).end(), means.level(l).begin());
  mesh_.for_each_box([&](int l, int b) {
    std::ptrdiff_t const plane = mesh_.box(l, b).stride(2);
    for (int k = 0; k < mesh_.box(l, b).extent(2); ++k)
      mesh_.for_each_covered_row(l, b, k, [&](std::ptrdiff_t at, int n) {
        std::fill_n(means.level(l).data() + mesh_.offset(l, b) + k * plane + at, n,
                    std::numeric_limits<Real>::quiet_NaN());
      });
  });
  add_second_differences(means, fourth_order::mean_less_point, false);
  average_.average_down(means);
}

std::vector<std::vector<std::vector<FourthOrderField::AddedDensity>>> FourthOrderField::beside_coarse_faces(
    Field const& density) {
  // Charges -8, 5 and 3 at 1, -1/2 and -3/2 fine widths from the face have a dipole only, of -15; the coarse cell has
  // the volume of eight fine ones, and four of these before its face.
  constexpr Real of_coarse = -1.0 / 15, of_first = 5.0 / 60, of_second = 3.0 / 60;
  std::vector<std::vector<std::vector<AddedDensity>>> out;
  for (int l = 0; l < mesh_.levels(); ++l)
    out.emplace_back(std::size_t(mesh_.level(l).last_local_box() - mesh_.level(l).first_local_box()));
  ghosts_.visit(density, nullptr, Ends::faces, FullyCovered::visit, [&](int l, int b) {
    Box const& own = mesh_.box(l, b);
    auto& added = out[std::size_t(l)][std::size_t(b)];
    ghosts_.for_each_coarse_face(l, b, [&](int axis, int side, Box const& first) {
      auto const [u, v] = tangential_axes(axis);
      Real const* const on_face = ghosts_.ghosts(axis, side, 0);
      Box const both = first.hull(first.layer(axis, side, -1));
      auto& density = added.emplace_back(AddedDensity{both.shift(own.lower), {}}).density;
      density.reserve(std::size_t(both.cells()));
      for_each_cell(both, [&, u = u, v = v](Index3 const& cell) {
        density.push_back((first.contains(cell) ? of_first : of_second) *
                          on_face[cell[u] + std::ptrdiff_t(cell[v]) * own.extent(u)]);
      });
    });
    RefinedSide const* last = nullptr;
    ghosts_.for_each_refined_face(
        l, b, [&](RefinedSide const& side, Index3 const&, int count, Real const* sums, std::ptrdiff_t step) {
          if (std::exchange(last, &side) != &side) added.push_back({side.cells.shift(own.lower), {}});
          for (int x = 0; x < count; ++x) added.back().density.push_back(of_coarse * (sums[x * step] / 4));
        });
  });
  return out;
}

ElectricField FourthOrderField::electric_field(Field const& phi, std::vector<Walls> const& walls, CoveredField covered,
                                               Holds holds) {
  std::array<std::shared_ptr<Field>, 3> e;
  for (auto& component : e) component = std::make_shared<Field>(phi.share_hierarchy(), false);
  ghosts_.visit(phi, &walls, Ends::of_field, FullyCovered::visit, [&](int l, int b) {
    for (int d = 0; d < 3; ++d) {
      Real const factor = 2 * mesh_.factor_of_field(l, d);
      for_each_row_in_line(l, b, d, phi, [&](std::ptrdiff_t place, int count, Rows const& at) {
        Real* __restrict const out = e[std::size_t(d)]->level(l).data() + place;
        for (int x = 0; x < count; ++x)
          out[x] = factor * fourth_order::mean_field(at[0][x], at[1][x], at[3][x], at[4][x]);
      });
    }
  });
  std::array<std::shared_ptr<Field const>, 3> out;
  for (std::size_t d = 0; d < 3; ++d) {
    if (covered == CoveredField::mean) average_.average_down(*e[d]);
    if (holds == Holds::points) {
      auto points = std::make_shared<Field>(phi.share_hierarchy(), false);
      to_points(*e[d], *points);
      e[d] = std::move(points);
    }
    out[d] = e[d];
  }
  return ElectricField(out);
}

Real FourthOrderField::truncation(Field const& phi, std::vector<Walls> const& walls, std::vector<Real> const& scale,
                                  Blocks<float> const& truncation) {
  Field sum(phi.share_hierarchy()), fourth(phi.share_hierarchy(), false);
  for (int d = 0; d < 3; ++d) {
    ghosts_.visit(phi, &walls, Ends::ghosts, FullyCovered::visit, [&](int l, int b) {
      for_each_row_in_line(l, b, d, phi, [&](std::ptrdiff_t place, int count, Rows const& at) {
        Real* __restrict const out = fourth.level(l).data() + place;
        for (int x = 0; x < count; ++x) out[x] = (at[0][x] + at[4][x]) - 4 * (at[1][x] + at[3][x]) + 6 * at[2][x];
      });
    });
    ghosts_.visit(fourth, nullptr, Ends::nothing, FullyCovered::visit, [&](int l, int b) {
      Real const weight = mesh_.equation(l).weight[d];
      for_each_row_in_line(l, b, d, fourth, [&](std::ptrdiff_t place, int count, Rows const& at) {
        Real* __restrict const out = sum.level(l).data() + place;
        for (int x = 0; x < count; ++x) {
          Real const sixth = central_difference(at[1][x], at[2][x], at[3][x]);
          out[x] += sixth == sixth ? fourth_order::truncation_error(weight, sixth) : 0;  // not a number beyond ends
        }
      });
    });
  }
  Real largest = 0;
  mesh_.for_each_box([&](int l, int b) {
    std::ptrdiff_t const plane = mesh_.box(l, b).stride(2);
    for (int k = 0; k < mesh_.box(l, b).extent(2); ++k) {
      Real* const values = sum.level(l).data() + mesh_.offset(l, b) + k * plane;
      mesh_.clear_covered(l, b, k, values);
      for (std::ptrdiff_t i = 0; i < plane; ++i) largest = std::max(largest, std::abs(values[i]));
      mesh_.write_plane(l, b, k, values, scale[std::size_t(l)], truncation[std::size_t(l)][std::size_t(b)]);
    }
  });
  return mesh_.comm().largest(largest);
}

}  // namespace amrpic
