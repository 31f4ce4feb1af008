#include "freespace/interpolation.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace amrpic::freespace {

namespace {

/// Weights of the nodes 0 .. 5 for a place x.
std::array<double, stencil> lagrange_weights(double x) {
  std::array<double, stencil> out;
  for (int n = 0; n < stencil; ++n) {
    double weight = 1;
    for (int m = 0; m < stencil; ++m)
      if (m != n) weight *= (x - m) / (n - m);
    out[n] = weight;
  }
  return out;
}

int first_node(double x, int size) { return std::clamp(int(std::floor(x)) - 2, 0, size - stencil); }

/// Interval n of `count` - 1, halved: where its stencil starts, and the weights.
struct Halving {
  int start;
  std::array<double, stencil> weights;
  Halving(int n, int count) : start(first_node(n + 0.5, count)), weights(lagrange_weights(n + 0.5 - start)) {}
};

}  // namespace

double interpolation_error(double distance) {
  double const g = 1 + 0.8 * distance * distance;
  return 1 / (std::max(distance, 1e-3) * g * g * g);
}

double interpolate(std::vector<double> const& values, std::array<int, 2> const& size, double x, double y) {
  int const i = first_node(x, size[0]), j = first_node(y, size[1]);
  auto const u = lagrange_weights(x - i), v = lagrange_weights(y - j);
  double sum = 0;
  for (int b = 0; b < stencil; ++b) {
    double row = 0;
    for (int a = 0; a < stencil; ++a) row += u[a] * values[std::size_t(i + a) + std::size_t(size[0]) * (j + b)];
    sum += v[b] * row;
  }
  return sum;
}

std::vector<double> double_rows(std::vector<double> const& values, int nu, int nv) {
  int const wide = 2 * nu - 1;
  std::vector<double> out(std::size_t(wide) * nv);
  std::vector<Halving> halvings;
  for (int i = 0; i + 1 < nu; ++i) halvings.emplace_back(i, nu);
  for (int j = 0; j < nv; ++j) {
    double const* from = values.data() + std::size_t(nu) * j;
    double* to = out.data() + std::size_t(wide) * j;
    for (int i = 0; i < nu; ++i) to[2 * i] = from[i];
    for (int i = 0; i + 1 < nu; ++i) {
      double sum = 0;
      for (int m = 0; m < stencil; ++m) sum += halvings[i].weights[m] * from[halvings[i].start + m];
      to[2 * i + 1] = sum;
    }
  }
  return out;
}

std::vector<double> double_columns(std::vector<double> const& values, int nu, int nv) {
  std::vector<double> out(std::size_t(nu) * (2 * nv - 1));
  for (int j = 0; j < nv; ++j)
    std::copy_n(values.data() + std::size_t(nu) * j, nu, out.data() + std::size_t(nu) * 2 * j);
  for (int j = 0; j + 1 < nv; ++j) {
    Halving const halving(j, nv);
    double* to = out.data() + std::size_t(nu) * (2 * j + 1);
    for (int m = 0; m < stencil; ++m) {
      double const* from = values.data() + std::size_t(nu) * (halving.start + m);
      for (int i = 0; i < nu; ++i) to[i] += halving.weights[m] * from[i];
    }
  }
  return out;
}

}  // namespace amrpic::freespace
