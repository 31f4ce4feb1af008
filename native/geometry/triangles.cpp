#include "geometry/triangles.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

namespace amrpic {

namespace {

constexpr int triangles_of_leaf = 4;

/// A line, and space sheared so that it becomes the axis `along`.
struct ShearedLine {
  Real3 start, direction;
  int along, u, v;  ///< right-handed in the order u, v, along
  Real slope_u, slope_v;
  Real3 inverse;

  ShearedLine(Real const* from, Real const* way) {
    for (int d = 0; d < 3; ++d) start[d] = from[d], direction[d] = way[d];
    along = 0;
    for (int d = 1; d < 3; ++d)
      if (std::abs(direction[d]) > std::abs(direction[along])) along = d;
    u = (along + 1) % 3, v = (along + 2) % 3;
    for (int d = 0; d < 3; ++d) inverse[d] = 1 / direction[d];
    slope_u = direction[u] / direction[along], slope_v = direction[v] / direction[along];
  }

  bool is_valid() const { return direction[along] != 0; }

  /// A point beside the line: the two coordinates across it.
  std::array<Real, 2> beside(Real3 const& point) const {
    Real const height = point[along] - start[along];
    return {point[u] - start[u] - slope_u * height, point[v] - start[v] - slope_v * height};
  }

  Real parameter(Real3 const& point) const { return (point[along] - start[along]) / direction[along]; }

  bool meets(Real3 const& lower, Real3 const& upper, Real margin) const {
    Real first = -std::numeric_limits<Real>::infinity(), last = -first;
    for (int d = 0; d < 3; ++d) {
      Real const low = lower[d] - margin - start[d], high = upper[d] + margin - start[d];
      if (direction[d] == 0) {
        if (low > 0 || high < 0) return false;
        continue;
      }
      Real const one = low * inverse[d], other = high * inverse[d];
      first = std::max(first, std::min(one, other)), last = std::min(last, std::max(one, other));
    }
    return first <= last;
  }
};

Real cross(std::array<Real, 2> const& a, std::array<Real, 2> const& b) { return a[0] * b[1] - a[1] * b[0]; }

/// +1 or -1 if an edge crosses the half line from the origin along the first coordinate, upwards or downwards. The two
/// triangles at an edge take its ends in the same order, so that what one gains the other loses, whatever the rounding.
int crosses(std::array<Real, 2> const& a, std::array<Real, 2> const& b) {
  bool const a_above = a[1] > 0, b_above = b[1] > 0;
  if (a_above == b_above) return 0;
  if (b_above) return cross(a, b) > 0 ? 1 : 0;
  return cross(b, a) > 0 ? -1 : 0;
}

/// How often a line goes round inside a triangle: 1 if it leaves through it, -1 if it enters, for a line along
/// +`along`.
int turns(std::array<std::array<Real, 2>, 3> const& p) {
  return crosses(p[0], p[1]) + crosses(p[1], p[2]) + crosses(p[2], p[0]);
}

/// Whether the origin is nearer to an edge than `most`.
bool passes(std::array<Real, 2> const& a, std::array<Real, 2> const& b, Real most) {
  std::array<Real, 2> const way{b[0] - a[0], b[1] - a[1]};
  Real const square = way[0] * way[0] + way[1] * way[1];
  if (cross(a, b) * cross(a, b) > most * most * square) return false;
  Real const along = -(a[0] * way[0] + a[1] * way[1]), slack = most * std::sqrt(square);
  return along >= -slack && along <= square + slack;
}

Real parameter_at(ShearedLine const& line, Triangles::Corners const& corners,
                  std::array<std::array<Real, 2>, 3> const& p) {
  std::array<Real, 3> const at{line.parameter(corners[0]), line.parameter(corners[1]), line.parameter(corners[2])};
  std::array<Real, 3> const area{cross(p[1], p[2]), cross(p[2], p[0]), cross(p[0], p[1])};
  auto const [low, high] = std::minmax_element(at.begin(), at.end());
  Real const whole = area[0] + area[1] + area[2];
  // From the first corner, so that triangles across the line get its coordinate without rounding.
  Real const value = at[0] + (area[1] * (at[1] - at[0]) + area[2] * (at[2] - at[0])) / whole;
  return std::isfinite(value) ? std::clamp(value, *low, *high) : *low;
}

Real3 centre_of(Triangles::Corners const& c) {
  Real3 out;
  for (int d = 0; d < 3; ++d) out[d] = c[0][d] + c[1][d] + c[2][d];
  return out;
}

}  // namespace

Triangles::Triangles(std::vector<Corners> corners, std::vector<int> weight)
    : corners_(std::move(corners)), weight_(std::move(weight)), order_(corners_.size()) {
  std::iota(order_.begin(), order_.end(), 0);
  if (corners_.empty()) return;
  nodes_.reserve(corners_.size());
  build(0, int(corners_.size()));
  for (int d = 0; d < 3; ++d) {
    margin_ = std::max(margin_, std::max(std::abs(nodes_[0].lower[d]), std::abs(nodes_[0].upper[d])));
  }
  rounding_ = 1e-12 * margin_;
  margin_ *= 1e-9;
}

int Triangles::build(int first, int last) {
  int const number = int(nodes_.size());
  nodes_.push_back({});
  Real const far = std::numeric_limits<Real>::infinity();
  Real3 lower{far, far, far}, upper{-far, -far, -far}, low = lower, high = upper;
  for (int n = first; n < last; ++n) {
    Real3 const centre = centre_of(corners_[order_[n]]);
    for (int d = 0; d < 3; ++d) {
      low[d] = std::min(low[d], centre[d]), high[d] = std::max(high[d], centre[d]);
      for (auto const& corner : corners_[order_[n]])
        lower[d] = std::min(lower[d], corner[d]), upper[d] = std::max(upper[d], corner[d]);
    }
  }
  Node node{lower, upper, first, last - first};
  if (last - first > triangles_of_leaf) {
    int axis = 0;
    for (int d = 1; d < 3; ++d)
      if (high[d] - low[d] > high[axis] - low[axis]) axis = d;
    int const middle = (first + last) / 2;
    std::nth_element(order_.begin() + first, order_.begin() + middle, order_.begin() + last, [&](int a, int b) {
      Real const at_a = centre_of(corners_[a])[axis], at_b = centre_of(corners_[b])[axis];
      return at_a != at_b ? at_a < at_b : a < b;
    });
    build(first, middle);
    node.first = build(middle, last), node.count = 0;
  }
  nodes_[number] = node;
  return number;
}

LineCrossings Triangles::crossings(Real const* start, Real const* direction, std::int64_t count) const {
  LineCrossings out;
  std::vector<int> to_visit;
  for (std::int64_t n = 0; n < count && !nodes_.empty(); ++n) {
    ShearedLine const line(start + 3 * n, direction + 3 * n);
    if (!line.is_valid()) continue;
    int const way = line.direction[line.along] > 0 ? 1 : -1;
    to_visit.assign(1, 0);
    while (!to_visit.empty()) {
      int const number = to_visit.back();
      Node const& node = nodes_[number];
      to_visit.pop_back();
      if (!line.meets(node.lower, node.upper, margin_)) continue;
      if (node.count == 0) {
        to_visit.push_back(node.first);
        to_visit.push_back(number + 1);
      }
      for (int t = node.first; t < node.first + node.count; ++t) {
        Corners const& corners = corners_[order_[t]];
        std::array<std::array<Real, 2>, 3> const p{line.beside(corners[0]), line.beside(corners[1]),
                                                   line.beside(corners[2])};
        if ((out.grazing.empty() || out.grazing.back() != n) &&
            (passes(p[0], p[1], rounding_) || passes(p[1], p[2], rounding_) || passes(p[2], p[0], rounding_)))
          out.grazing.push_back(n);
        int const leaves = turns(p) * way;
        if (leaves == 0) continue;
        out.line.push_back(n);
        out.parameter.push_back(parameter_at(line, corners, p));
        out.depth.push_back(-leaves * weight_[order_[t]]);
        out.triangle.push_back(order_[t]);
      }
    }
  }
  return out;
}

}  // namespace amrpic
