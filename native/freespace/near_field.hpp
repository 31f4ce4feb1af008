// Sums of charges times the lattice Green's function, for ghosts anywhere between the points of the charges' lattice.
//
// A ghost of a finer level lies between the lattice points of a coarser one, and the function there is the cubic
// through the four points around it along each axis. That is the same as the cubic through the potentials at these
// points, of which neighbouring ghosts share most. So one table serves ghosts of all levels. Between the points of a
// table of wider spacing the ghosts of a patch are interpolated from eight of them.
//
// In fourth order potentials are means over cells, and so are those at the points of a lattice. A mean over a cell of
// width r between points that are one apart, each standing for a mean over a width w, is the cubic through them and
// (r^2 - w^2) / 24 of its second derivative, along each axis.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "freespace/ghost_patches.hpp"
#include "freespace/kernel_table.hpp"
#include "freespace/node_charges.hpp"

namespace amrpic::freespace {

/// The points next to a place along an axis, by number in a list of points, and their weights.
struct InterpolationStencil {
  int count = 0;
  std::array<int, node_count> at{};  ///< first the points themselves, then their numbers
  std::array<double, node_count> weight{};

  void add(int point, double w) {
    if (w != 0) at[count] = point, weight[count++] = w;
  }
};

/// Around a place among the whole numbers. `curvature`: of how much of the second derivative is added.
inline InterpolationStencil stencil_at(double place, double curvature) {
  double const floor = std::floor(place);
  auto const weights = cubic_weights(place - floor), curvatures = cubic_curvatures(place - floor);
  InterpolationStencil out;
  for (int m = 0; m < 4; ++m)
    out.add(int(floor) - 1 + m, curvature == 0 ? weights[m] : weights[m] + curvature * curvatures[m]);
  return out;
}

/// Where the cells of one level lie along an axis, among the lattice points of another one: at `point` + shift.
struct LatticePlace {
  int point;
  double shift;
};

inline LatticePlace place_in_level(int cell, int cell_level, int level) {
  double const x = std::ldexp(cell + 0.5, level - cell_level) - 0.5, floor = std::floor(x);
  return {int(floor), x - floor};
}

/// What of the second derivative leads from means over cells of the charges' level, or over two of them, to those over
/// ghosts of another level.
inline double between_means(int level, int ghost_level, bool half) {
  return (std::ldexp(1.0, 2 * (level - ghost_level)) - (half ? 4 : 1)) / 24;
}

/// Around a place, from given nodes.
inline InterpolationStencil stencil_of(Nodes const& nodes, double place) {
  auto const weights = lagrange_weights(nodes, place);
  InterpolationStencil out;
  for (int n = 0; n < node_count; ++n) out.add(nodes[n], weights[n]);
  return out;
}

/// Stencils of several places, and all points of them, ascending.
struct StencilRow {
  std::vector<int> points;
  std::vector<InterpolationStencil> of;

  StencilRow() = default;
  explicit StencilRow(std::vector<InterpolationStencil> stencils) : of(std::move(stencils)) {
    for (InterpolationStencil const& s : of) points.insert(points.end(), s.at.begin(), s.at.begin() + s.count);
    std::sort(points.begin(), points.end());
    points.erase(std::unique(points.begin(), points.end()), points.end());
    for (InterpolationStencil& s : of)
      for (int m = 0; m < s.count; ++m)
        s.at[m] = int(std::lower_bound(points.begin(), points.end(), s.at[m]) - points.begin());
  }
};

/// Sums of charges times the kernel at `count` points of a line along the rows. `rows`: where those of the
/// kernel begin for each row with charge, `along`: how far on for each point.
template <int count>
std::array<double, count> direct_sums(NodeCharges const& charges, std::array<double const*, block_rows> const& rows,
                                      std::ptrdiff_t const* along) {
  constexpr int chains = 4 / count;  // sums that do not wait for each other
  Lanes sum[chains][count] = {};
  auto const add_row = [&](int n, Lanes* to) {
    auto const charge = load<Lanes>(charges.values.data() + block_edge * charges.rows[n]);
    for (int t = 0; t < count; ++t) to[t] += charge * load<Lanes>(rows[n] + along[t]);
  };
  int n = 0;
  for (; n + chains <= charges.row_count; n += chains)
    for (int c = 0; c < chains; ++c) add_row(n + c, sum[c]);
  for (; n < charges.row_count; ++n) add_row(n, sum[0]);
  std::array<double, count> out;
  for (int t = 0; t < count; ++t) {
    for (int c = 1; c < chains; ++c) sum[0][t] += sum[c][t];
    out[t] = sum_of(sum[0][t]);
  }
  return out;
}

/// The points of a patch among the points of a table for charges of some level.
class NearGrid {
 public:
  /// `places`: of the points of the patch along each axis of the plane, and of all of them along the normal; `across`:
  /// the axes, that of the rows first.
  NearGrid(int normal, std::array<StencilRow, 3> places, std::array<int, 3> const& across)
      : normal_(normal), across_(across), places_(std::move(places)) {}

  /// Add to the values of the patch `scale` times what charges make at those points that `masks` has.
  void add(NodeCharges const& charges, KernelTable const& table, PointMasks const& masks, double scale,
           double* values) {
    auto const axes = plane_axes(normal_);
    unsigned columns = 0, rows = 0;
    for (int row = 0; row < patch_points; ++row) {
      columns |= masks[row];
      rows |= masks[row] ? 1u << row : 0;
    }
    StencilRow const &u = places_[axes[0]], &v = places_[axes[1]];
    std::array<std::vector<InputPoint>, 3> input;
    input[axes[0]] = input_along(u, columns, 1);
    input[axes[1]] = input_along(v, rows, u.points.size());
    InterpolationStencil const& through = places_[normal_].of.front();
    for (int m = 0; m < through.count; ++m)
      input[normal_].push_back({places_[normal_].points[through.at[m]], 0, through.weight[m]});
    add_sums(charges, table, input);
    for (int row = 0; row < patch_points; ++row)
      for (unsigned left = masks[row]; left; left &= left - 1) {
        int const t = __builtin_ctz(left);
        InterpolationStencil const &su = u.of[t], &sv = v.of[row];
        double value = 0;
        for (int b = 0; b < sv.count; ++b) {
          double const* const line = sums_.data() + u.points.size() * std::size_t(sv.at[b]);
          for (int a = 0; a < su.count; ++a) value += sv.weight[b] * su.weight[a] * line[su.at[a]];
        }
        values[row * patch_points + t] += scale * value;
      }
  }

 private:
  /// A point along an axis, where in the plane its potential belongs, and with which weight.
  struct InputPoint {
    int point;
    std::size_t place;
    double weight;
  };

  /// The points that the stencils in a mask need.
  static std::vector<InputPoint> input_along(StencilRow const& row, unsigned mask, std::size_t pitch) {
    std::vector<char> is_in(row.points.size());
    for (; mask; mask &= mask - 1) {
      InterpolationStencil const& s = row.of[__builtin_ctz(mask)];
      for (int m = 0; m < s.count; ++m) is_in[s.at[m]] = 1;
    }
    std::vector<InputPoint> out;
    for (std::size_t n = 0; n < is_in.size(); ++n)
      if (is_in[n]) out.push_back({row.points[n], pitch * n, 1});
    return out;
  }

  /// The potential at the input points of the plane.
  void add_sums(NodeCharges const& charges, KernelTable const& table,
                std::array<std::vector<InputPoint>, 3> const& input) {
    auto const [u, v, w] = across_;
    auto const& line = input[u];
    sums_.assign(places_[plane_axes(normal_)[0]].points.size() * places_[plane_axes(normal_)[1]].points.size(), 0.0);
    std::vector<std::ptrdiff_t> along;
    for (InputPoint const& at : line) along.push_back(charges.points[u][0] - at.point);
    std::array<double const*, block_rows> rows;
    for (InputPoint const& j : input[v])
      for (InputPoint const& k : input[w]) {
        std::array<std::ptrdiff_t, block_edge> along_v, along_w;
        for (int n = 0; n < block_edge; ++n) {
          along_v[n] = table.along(v, charges.points[v][n] - j.point);
          along_w[n] = table.along(w, charges.points[w][n] - k.point);
        }
        for (int n = 0; n < charges.row_count; ++n)
          rows[n] = table.row(0) + along_v[charges.rows[n] % block_edge] + along_w[charges.rows[n] / block_edge];
        auto const add = [&](std::size_t first, auto const& values) {
          for (std::size_t t = 0; t < values.size(); ++t) {
            InputPoint const& i = line[first + t];
            sums_[i.place + j.place + k.place] += i.weight * j.weight * k.weight * values[t];
          }
        };
        std::size_t i = 0;
        for (; i + 4 <= line.size(); i += 4) add(i, direct_sums<4>(charges, rows, along.data() + i));
        for (; i + 2 <= line.size(); i += 2) add(i, direct_sums<2>(charges, rows, along.data() + i));
        if (i < line.size()) add(i, direct_sums<1>(charges, rows, along.data() + i));
      }
  }

  int normal_;
  std::array<int, 3> across_;
  std::array<StencilRow, 3> places_;  ///< by axis
  std::vector<double> sums_;
};

}  // namespace amrpic::freespace
