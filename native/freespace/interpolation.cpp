#include "freespace/interpolation.hpp"

#include <algorithm>
#include <cmath>

namespace amrpic::freespace {

namespace {

constexpr double pi = 3.14159265358979323846;

}  // namespace

std::array<double, 4> cubic_weights(double s) {
  return {-s * (s - 1) * (s - 2) / 6, (s + 1) * (s - 1) * (s - 2) / 2, -(s + 1) * s * (s - 2) / 2,
          (s + 1) * s * (s - 1) / 6};
}

std::array<double, 4> cubic_curvatures(double s) { return {1 - s, 3 * s - 2, 1 - 3 * s, s}; }

Nodes chebyshev_points(int extent) {
  Nodes out;
  for (int i = 0; i < node_count / 2; ++i) {
    double const node = 0.5 * (1 - std::cos(pi * (i + 0.5) / node_count));
    out[i] = extent == node_count ? i : int(std::lround((extent - 1) * node));
    out[node_count - 1 - i] = extent - 1 - out[i];
  }
  return out;
}

Nodes nodes_between(double first, double last) {
  int const extent = std::max(node_count, int(std::lround(last - first)) + 1);
  Nodes out = chebyshev_points(extent);
  for (int& node : out) node += int(std::lround(0.5 * (first + last - (extent - 1))));
  return out;
}

std::array<double, node_count> lagrange_weights(Nodes const& nodes, double place) {
  std::array<double, node_count> out;
  for (int n = 0; n < node_count; ++n) {
    double here = 1, at_node = 1;
    for (int m = 0; m < node_count; ++m) {
      if (m == n) continue;
      here *= place - nodes[m];
      at_node *= nodes[n] - nodes[m];
    }
    out[n] = here / at_node;
  }
  return out;
}

}  // namespace amrpic::freespace
