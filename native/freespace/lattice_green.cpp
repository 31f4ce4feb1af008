#include "freespace/lattice_green.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace amrpic::freespace {

namespace {

constexpr double pi = 3.14159265358979323846;
constexpr int panel_nodes = 12;

struct Node {
  double place, weight;
};
constexpr double vanished = 40;  ///< exponents of waves that no longer count

/// Gauss-Legendre nodes on [0, 1]; the roots by Newton's method.
std::array<Node, panel_nodes> gauss_legendre() {
  std::array<Node, panel_nodes> out;
  int const n = panel_nodes;
  for (int i = 0; i < n; ++i) {
    double x = std::cos(pi * (i + 0.75) / (n + 0.5)), slope = 1;
    for (int iteration = 0; iteration < 10; ++iteration) {
      double before = 1, value = x;
      for (int k = 2; k <= n; ++k) {
        double const next = ((2 * k - 1) * x * value - (k - 1) * before) / k;
        before = value, value = next;
      }
      slope = n * (x * value - before) / (x * x - 1);
      x -= value / slope;
    }
    out[i] = {(1 - x) / 2, 1 / ((1 - x * x) * slope * slope)};
  }
  return out;
}

/// Large-argument expansion; each term is smaller than the one before by about (4 n^2) / (8 x).
double bessel_far(double x, int n) {
  double const mu = 4.0 * n * n;
  double sum = 1, term = 1;
  for (int k = 1; k < 40 && std::abs(term) > 1e-18 * std::abs(sum); ++k) {
    double const odd = 2 * k - 1;
    term *= -(mu - odd * odd) / (k * 8 * x);
    sum += term;
  }
  return sum / std::sqrt(2 * pi * x);
}

}  // namespace

std::vector<TimeNode> time_nodes(double shortest, double late) {
  auto const panel = gauss_legendre();
  std::vector<TimeNode> out;
  double start = 0, length = 0.25 * shortest * shortest;
  for (; start < late; start += length, length = start)
    for (Node const& n : panel) out.push_back({start + length * n.place, length * n.weight});
  double const last = 1 / std::sqrt(start);
  for (Node const& n : panel) {
    double const u = last * n.place;
    out.push_back({1 / (u * u), last * n.weight * 2 / (u * u * u)});
  }
  return out;
}

std::vector<double> scaled_bessel(double x, int last) {
  std::vector<double> out(std::size_t(last) + 1);
  if (x > 20.0 * std::max(25.0, double(last) * last)) {
    for (int n = 0; n <= last; ++n) out[n] = bessel_far(x, n);
    return out;
  }
  // Miller: downwards from an order where I_n has vanished, then scaled by exp(-x) (I_0 + 2 I_1 + 2 I_2 + ...) = 1.
  int const start = last + 40 + int(10 * std::sqrt(x));
  double above = 0, value = 1e-280, sum = 0;
  for (int n = start; n >= 0; --n) {
    if (n <= last) out[n] = value;
    sum += n > 0 ? 2 * value : value;
    double const below = above + (n > 0 ? 2 * n / x * value : 0);
    above = value, value = below;
    if (value > 1e250) {
      double const down = 1e-250;
      above *= down, value *= down, sum *= down;
      for (int k = n; k <= last; ++k) out[k] *= down;
    }
  }
  for (double& v : out) v /= sum;
  return out;
}

// The operator is -s (1 + s / 12), s = 2 - 2 cos k: means over waves by the trapezoidal rule, which is exact to
// rounding once it has so many points that the kernel has vanished as many cells away. Of these the first ones count.
std::vector<double> fourth_order_heat(double t, int last) {
  int const points = last + 40 + int(10 * std::sqrt(t));  // from 0 to pi
  std::vector<double> out(std::size_t(last) + 1, 0.0);
  for (int m = 0; m <= points; ++m) {
    double const k = pi * m / points, s = 2 - 2 * std::cos(k), exponent = t * s * (1 + s / 12);
    if (exponent > vanished) break;
    double const weight = (m == 0 || m == points ? 0.5 : 1.0) * std::exp(-exponent) / points;
    double const twice = 2 * std::cos(k);
    double before = std::cos(k), value = 1;  // cos n k
    for (int n = 0; n <= last; ++n) {
      out[std::size_t(n)] += weight * value;
      double const next = twice * value - before;
      before = value, value = next;
    }
  }
  return out;
}

std::vector<double> line_heat(double t, int last, int operator_order) {
  return operator_order == 4 ? fourth_order_heat(t, last) : scaled_bessel(2 * t, last);
}

// That of a line while it has not gone half way round; then a sum over waves, of which few are left.
std::vector<double> ring_heat(double t, int cells, int operator_order, bool has_mean) {
  std::vector<double> out(std::size_t(cells), 0.0);
  if (13 * std::sqrt(t) + 40 < cells / 2) {
    auto const line = line_heat(t, cells / 2, operator_order);
    for (int n = 0; n < cells; ++n) out[std::size_t(n)] = line[std::size_t(std::min(n, cells - n))];
    return out;
  }
  std::vector<double> cosine;
  for (int n = 0; n < cells; ++n) cosine.push_back(std::cos(2 * pi * n / cells));
  for (int m = has_mean ? 0 : 1; 2 * m <= cells; ++m) {
    double const s = 2 - 2 * cosine[std::size_t(m)];
    double const exponent = t * s * (operator_order == 4 ? 1 + s / 12 : 1);
    if (exponent > vanished) break;
    double const weight = (m == 0 || 2 * m == cells ? 1 : 2) * std::exp(-exponent) / cells;
    for (int n = 0, turn = 0; n < cells; ++n, turn = (turn + m) % cells)
      out[std::size_t(n)] += weight * cosine[std::size_t(turn)];
  }
  return out;
}

std::vector<double> lattice_green_octant(std::array<double, 3> const& spacing, std::array<int, 3> const& reach,
                                         std::array<int, 3> const& stride, int operator_order) {
  std::ptrdiff_t const nx = reach[0] + 1, ny = reach[1] + 1, nz = reach[2] + 1;
  std::vector<double> out(std::size_t(nx * ny * nz), 0.0);
  double const volume = spacing[0] * spacing[1] * spacing[2];
  double const smallest = std::min({spacing[0], spacing[1], spacing[2]});
  double const largest = std::max({spacing[0], spacing[1], spacing[2]});
  double extent = 0;
  for (int d = 0; d < 3; ++d) extent = std::max(extent, (reach[d] * stride[d] + 1) * spacing[d]);
  // Then the kernels have spread far past the reach.
  for (TimeNode const& node : time_nodes(smallest, 4 * extent * extent + 64 * largest * largest)) {
    std::array<std::vector<double>, 3> kernel;
    for (int d = 0; d < 3; ++d) {
      kernel[d] = line_heat(node.time / (spacing[d] * spacing[d]), reach[d] * stride[d], operator_order);
      for (int n = 0; n <= reach[d]; ++n) kernel[d][n] = kernel[d][n * stride[d]];
    }
    for (std::ptrdiff_t k = 0; k < nz; ++k)
      for (std::ptrdiff_t j = 0; j < ny; ++j) {
        double const factor = node.weight / volume * kernel[1][j] * kernel[2][k];
        double* row = out.data() + nx * (j + ny * k);
        for (std::ptrdiff_t i = 0; i < nx; ++i) row[i] += factor * kernel[0][i];
      }
  }
  return out;
}

}  // namespace amrpic::freespace
