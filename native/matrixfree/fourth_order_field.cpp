#include "matrixfree/fourth_order_field.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace amrpic {

namespace {

using Ends = FourthOrderGhosts::Ends;

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

/// Call f(cell, counted from the first one of the box; place among the own cells of the level).
template <class F>
void FourthOrderField::for_each_cell_of(int l, int b, F&& f) const {
  Box const& own = mesh_.box(l, b);
  std::size_t place = std::size_t(mesh_.offset(l, b));
  for_each_cell(own.shift_back(own.lower), [&](Index3 const& cell) { f(cell, place++); });
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
  std::vector<Real> differences;
  int level = -1;
  auto const add = [&] {
    for (std::size_t i = 0; i < differences.size(); ++i) field.level(level)[i] += factor * differences[i];
  };
  ghosts_.visit(field, nullptr, Ends::nothing, FullyCovered::visit, [&](int l, int b) {
    if (l != level) {
      add();
      level = l;
      differences.assign(field.level(l).size(), 0.0);
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
    std::ptrdiff_t const plane = pitches(mesh_.box(l, b))[2];
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
    Index3 const lower = mesh_.box(l, b).lower;
    auto& added = out[std::size_t(l)][std::size_t(b)];
    auto const add = [&](Index3 cell, Real value) {
      for (int d = 0; d < 3; ++d) cell[d] += lower[d];
      if (value != 0) added.push_back({cell, value});
    };
    ghosts_.for_each_coarse_face(l, b, [&](Index3 cell, Index3 const& inwards, Real on_face) {
      add(cell, of_first * on_face);
      for (int d = 0; d < 3; ++d) cell[d] += inwards[d];
      add(cell, of_second * on_face);
    });
    ghosts_.for_each_refined_face(l, b, [&](Index3 const& cell, Real on_face) { add(cell, of_coarse * on_face); });
  });
  return out;
}

ElectricField FourthOrderField::electric_field(Field const& phi, std::vector<Walls> const& walls, CoveredField covered,
                                               Holds holds) {
  std::array<std::shared_ptr<Field>, 3> e;
  for (auto& component : e) component = std::make_shared<Field>(phi.share_hierarchy(), false);
  ghosts_.visit(phi, &walls, Ends::of_field, FullyCovered::visit, [&](int l, int b) {
    Box const& own = mesh_.box(l, b);
    Real const* const cells = phi.level(l).data() + mesh_.offset(l, b);
    for (int d = 0; d < 3; ++d) {
      Real const factor = 2 * mesh_.factor_of_field(l, d);
      std::ptrdiff_t const step = pitches(own)[d];
      for_each_cell_of(l, b, [&](Index3 const& cell, std::size_t place) {
        auto const at = ghosts_.in_line(own, cells, d, cell);
        Real const* const c = phi.level(l).data() + place;
        bool const inside = cell[d] >= 2 && cell[d] + 2 < own.extent(d);
        e[std::size_t(d)]->level(l)[place] =
            factor * (inside ? fourth_order::mean_field(c[-2 * step], c[-step], c[step], c[2 * step])
                             : fourth_order::mean_field(at(-2), at(-1), at(1), at(2)));
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

template <class T>
Real FourthOrderField::truncation(Field const& phi, std::vector<Walls> const& walls, std::vector<Real> const& scale,
                                  Blocks<T> const& truncation) {
  Field sum(phi.share_hierarchy()), fourth(phi.share_hierarchy(), false);
  for (int d = 0; d < 3; ++d) {
    ghosts_.visit(phi, &walls, Ends::ghosts, FullyCovered::visit, [&](int l, int b) {
      Box const& own = mesh_.box(l, b);
      Real const* const cells = phi.level(l).data() + mesh_.offset(l, b);
      for_each_cell_of(l, b, [&](Index3 const& cell, std::size_t place) {
        auto const at = ghosts_.in_line(own, cells, d, cell);
        fourth.level(l)[place] = (at(-2) + at(2)) - 4 * (at(-1) + at(1)) + 6 * at(0);
      });
    });
    ghosts_.visit(fourth, nullptr, Ends::nothing, FullyCovered::visit, [&](int l, int b) {
      Box const& own = mesh_.box(l, b);
      Real const* const cells = fourth.level(l).data() + mesh_.offset(l, b);
      Real const weight = mesh_.equation(l).weight[d];
      for_each_cell_of(l, b, [&](Index3 const& cell, std::size_t place) {
        auto const at = ghosts_.in_line(own, cells, d, cell);
        Real const sixth = (at(-1) - at(0)) + (at(1) - at(0));
        if (!std::isnan(sixth)) sum.level(l)[place] += fourth_order::truncation_error(weight, sixth);
      });
    });
  }
  Real largest = 0;
  mesh_.for_each_box([&](int l, int b) {
    std::ptrdiff_t const plane = pitches(mesh_.box(l, b))[2];
    for (int k = 0; k < mesh_.box(l, b).extent(2); ++k) {
      Real* const values = sum.level(l).data() + mesh_.offset(l, b) + k * plane;
      mesh_.clear_covered(l, b, k, values);
      for (std::ptrdiff_t i = 0; i < plane; ++i) largest = std::max(largest, std::abs(values[i]));
      mesh_.write_plane(l, b, k, values, scale[std::size_t(l)], truncation[std::size_t(l)][std::size_t(b)]);
    }
  });
  return mesh_.comm().largest(largest);
}
template Real FourthOrderField::truncation(Field const&, std::vector<Walls> const&, std::vector<Real> const&,
                                           Blocks<float> const&);

}  // namespace amrpic
