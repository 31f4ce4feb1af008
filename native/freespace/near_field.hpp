// Sums of charges times the lattice Green's function, for ghosts anywhere between the points of the charges' lattice.
//
// A ghost of a finer level lies between the lattice points of a coarser one, and the function there is the cubic
// through the four points around it along each axis. That is the same as the cubic through the potentials at these
// points, of which neighbouring ghosts share most. So one table serves ghosts of all levels. Likewise charges are dealt
// out to the points of a table of wider spacing by the same cubic, where that serves; these points are chosen so that
// ghosts which are further apart lie on them.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "freespace/ghost_patches.hpp"
#include "freespace/kernel_table.hpp"
#include "freespace/leaves.hpp"

namespace amrpic::freespace {

/// The points around a place along an axis, by number in a list of points, and their weights.
struct Stencil {
  int count = 0;
  std::array<int, 4> at{};  ///< first the points themselves, then their numbers
  std::array<double, 4> weight{};

  void add(int point, double w) {
    if (w != 0) at[count] = point, weight[count++] = w;
  }
};

/// Around a place among the whole numbers.
inline Stencil stencil_at(double place) {
  double const floor = std::floor(place);
  auto const weights = cubic_weights(place - floor);
  Stencil out;
  for (int m = 0; m < 4; ++m) out.add(int(floor) - 1 + m, weights[m]);
  return out;
}

/// Stencils of several places, and all points of them, ascending.
struct StencilRow {
  std::vector<int> points;
  std::vector<Stencil> of;

  explicit StencilRow(std::vector<Stencil> stencils) : of(std::move(stencils)) {
    for (Stencil const& s : of) points.insert(points.end(), s.at.begin(), s.at.begin() + s.count);
    std::sort(points.begin(), points.end());
    points.erase(std::unique(points.begin(), points.end()), points.end());
    for (Stencil& s : of)
      for (int m = 0; m < s.count; ++m)
        s.at[m] = int(std::lower_bound(points.begin(), points.end(), s.at[m]) - points.begin());
  }
};

/// Points along each axis, among those of a lattice: origin + stride times a whole number; all of them if the stride is
/// one.
struct PointsApart {
  Cell stride;
  Point origin;

  double place(int axis, double cell) const { return stride[axis] == 1 ? cell : (cell - origin[axis]) / stride[axis]; }
};

/// The charges of a leaf on points apart; there are never more than eight along an axis.
struct SpreadCharges {
  LeafCharges::Block block{};
  Cell corner;

  SpreadCharges(LeafCharges::Block const& given, Cell const& first, PointsApart const& points) {
    std::array<std::array<Stencil, block_edge>, 3> to;
    for (int d = 0; d < 3; ++d) {
      corner[d] = points.stride[d] == 1 ? first[d] : int(std::floor(points.place(d, first[d]))) - 1;
      for (int i = 0; i < block_edge; ++i) {
        to[d][i] = stencil_at(points.place(d, first[d] + i));
        for (int m = 0; m < to[d][i].count; ++m) to[d][i].at[m] -= corner[d];
      }
    }
    std::array<bool, block_edge * block_edge> has_charge{};
    for (int n = 0; n < given.row_count; ++n) {
      int const row = given.rows[n];
      Stencil const &y = to[1][row % block_edge], &z = to[2][row / block_edge];
      double const* const charges = given.values.data() + block_edge * row;
      std::array<double, block_edge> line{};
      for (int i = 0; i < block_edge; ++i)
        for (int m = 0; m < to[0][i].count && charges[i] != 0; ++m)
          line[to[0][i].at[m]] += to[0][i].weight[m] * charges[i];
      for (int b = 0; b < z.count; ++b)
        for (int a = 0; a < y.count; ++a) {
          int const there = y.at[a] + block_edge * z.at[b];
          has_charge[there] = true;
          for (int i = 0; i < block_edge; ++i)
            block.values[block_edge * there + i] += y.weight[a] * z.weight[b] * line[i];
        }
    }
    for (int row = 0; row < block_edge * block_edge; ++row)
      if (has_charge[row]) block.rows[block.row_count++] = static_cast<unsigned char>(row);
  }
};

/// Sums of charges, of which the first is at `corner`, times the kernel, seen from some points.
template <std::size_t count>
std::array<double, count> direct_sums(LeafCharges::Block const& charges, Cell const& corner,
                                      std::array<Cell, count> const& points, KernelTable const& table) {
  std::array<double const*, count> first;
  std::array<std::array<std::ptrdiff_t, block_edge>, count> along_y, along_z;
  for (std::size_t t = 0; t < count; ++t) {
    first[t] = table.row(corner[0] - points[t][0]);
    for (int n = 0; n < block_edge; ++n) {
      along_y[t][n] = table.along(1, corner[1] - points[t][1] + n);
      along_z[t][n] = table.along(2, corner[2] - points[t][2] + n);
    }
  }
  Lanes sum[count] = {};
  for (int n = 0; n < charges.row_count; ++n) {
    int const row = charges.rows[n];
    auto const charge = load<Lanes>(charges.values.data() + block_edge * row);
    for (std::size_t t = 0; t < count; ++t) {
      auto const value = load<Lanes>(first[t] + along_y[t][row % block_edge] + along_z[t][row / block_edge]);
      sum[t] += charge * value;
    }
  }
  std::array<double, count> out;
  for (std::size_t t = 0; t < count; ++t) out[t] = sum_of(sum[t]);
  return out;
}

/// The points of a patch among the points of a table for charges of some level.
class NearGrid {
 public:
  /// `places`: of the points of the patch along its axes u and v, and of all of them along the normal.
  NearGrid(int normal, StencilRow u, StencilRow v, StencilRow across)
      : normal_(normal), u_(std::move(u)), v_(std::move(v)), across_(std::move(across)) {}

  /// Add to the values of the patch `scale` times what charges make at those points that `masks` has: bit t of number
  /// `row`.
  void add(LeafCharges::Block const& charges, Cell const& corner, KernelTable const& table,
           std::array<unsigned, patch_points> const& masks, double scale, double* values) {
    std::vector<char> in_u(u_.points.size()), in_v(v_.points.size());
    unsigned columns = 0;
    for (unsigned mask : masks) columns |= mask;
    for (int t = 0; t < patch_points; ++t) {
      if (columns >> t & 1)
        for (int m = 0; m < u_.of[t].count; ++m) in_u[u_.of[t].at[m]] = 1;
      if (masks[t])
        for (int m = 0; m < v_.of[t].count; ++m) in_v[v_.of[t].at[m]] = 1;
    }
    Stencil const& through = across_.of.front();
    sums_.assign(u_.points.size() * v_.points.size(), 0.0);
    for (int c = 0; c < through.count; ++c)
      for (std::size_t b = 0; b < in_v.size(); ++b)
        if (in_v[b]) add_line(charges, corner, table, in_u, int(b), through.at[c], through.weight[c]);
    for (int row = 0; row < patch_points; ++row)
      for (unsigned left = masks[row]; left; left &= left - 1) {
        int const t = __builtin_ctz(left);
        Stencil const &su = u_.of[t], &sv = v_.of[row];
        double value = 0;
        for (int b = 0; b < sv.count; ++b) {
          double const* const line = sums_.data() + u_.points.size() * std::size_t(sv.at[b]);
          for (int a = 0; a < su.count; ++a) value += sv.weight[b] * su.weight[a] * line[su.at[a]];
        }
        values[row * patch_points + t] += scale * value;
      }
  }

 private:
  /// The potential at the wanted points of a line along u.
  void add_line(LeafCharges::Block const& charges, Cell const& corner, KernelTable const& table,
                std::vector<char> const& wanted, int b, int c, double weight) {
    constexpr std::size_t at_once = 4;
    auto const [u, v] = plane_axes(normal_);
    double* const line = sums_.data() + u_.points.size() * std::size_t(b);
    std::array<std::size_t, at_once> numbers{};
    std::array<Cell, at_once> points;
    Cell point;
    point[v] = v_.points[b], point[normal_] = across_.points[c];
    std::size_t count = 0;
    auto const sum_up = [&] {
      for (std::size_t t = count; t < at_once; ++t) points[t] = points[0];
      auto const sums = direct_sums(charges, corner, points, table);
      for (std::size_t t = 0; t < count; ++t) line[numbers[t]] += weight * sums[t];
      count = 0;
    };
    for (std::size_t a = 0; a < wanted.size(); ++a) {
      if (!wanted[a]) continue;
      point[u] = u_.points[a];
      points[count] = point, numbers[count++] = a;
      if (count == at_once) sum_up();
    }
    if (count > 0) sum_up();
  }

  int normal_;
  StencilRow u_, v_, across_;
  std::vector<double> sums_;
};

}  // namespace amrpic::freespace
