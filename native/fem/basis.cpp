#include "fem/basis.hpp"

#include <array>
#include <cmath>

namespace amrpic::fem {

namespace {

Real const pi = std::acos(Real(-1));

/// Legendre's polynomial of a degree at x, and its slope.
std::array<Real, 2> legendre(int degree, Real x) {
  Real before = 1, here = x;
  for (int n = 2; n <= degree; ++n) {
    Real const next = ((2 * n - 1) * x * here - (n - 1) * before) / n;
    before = here, here = next;
  }
  return {here, degree * (x * here - before) / (x * x - 1)};
}

}  // namespace

Quadrature gauss_rule(int count) {
  Quadrature out;
  for (int i = count; i >= 1; --i) {
    Real x = std::cos(pi * (4 * i - 1) / (4 * count + 2)), slope = 0;
    if (count == 1) x = 0;
    for (int step = 0; step < 100; ++step) {
      auto const [value, by] = legendre(count, x);
      slope = by;
      Real const before = x;
      x -= value / slope;
      if (std::abs(x - before) < 1e-16) break;
    }
    slope = legendre(count, x)[1];
    out.place.push_back(x);
    out.weight.push_back(2 / ((1 - x * x) * slope * slope));
  }
  return out;
}

std::vector<Real> lobatto_nodes(int degree) {
  Real const third = 1 / std::sqrt(Real(5)), fourth = std::sqrt(Real(3) / 7);
  if (degree == 1) return {-1, 1};
  if (degree == 2) return {-1, 0, 1};
  if (degree == 3) return {-1, -third, third, 1};
  return {-1, -fourth, 0, fourth, 1};
}

std::vector<Real> lagrange_values(std::vector<Real> const& nodes, Real x) {
  std::vector<Real> out(nodes.size(), 1);
  for (std::size_t i = 0; i < nodes.size(); ++i)
    for (std::size_t j = 0; j < nodes.size(); ++j)
      if (j != i) out[i] *= (x - nodes[j]) / (nodes[i] - nodes[j]);
  return out;
}

std::vector<Real> lagrange_slopes(std::vector<Real> const& nodes, Real x) {
  std::vector<Real> out(nodes.size(), 0);
  for (std::size_t i = 0; i < nodes.size(); ++i)
    for (std::size_t d = 0; d < nodes.size(); ++d) {  // the factor that the derivative takes
      if (d == i) continue;
      Real product = 1 / (nodes[i] - nodes[d]);
      for (std::size_t j = 0; j < nodes.size(); ++j)
        if (j != i && j != d) product *= (x - nodes[j]) / (nodes[i] - nodes[j]);
      out[i] += product;
    }
  return out;
}

// The coefficients of a polynomial of degree below P are sums over Chebyshev's P points.
template <int P>
Matrix<P> nodes_to_chebyshev() {
  Matrix<P> out{};
  auto const nodes = lobatto_nodes(P - 1);
  for (int m = 0; m < P; ++m) {
    Real const angle = pi * (2 * m + 1) / (2 * P);
    auto const values = lagrange_values(nodes, std::cos(angle));
    for (int i = 0; i < P; ++i)
      for (int l = 0; l < P; ++l) out[i][l] += (i == 0 ? 1 : 2) * std::cos(i * angle) * values[std::size_t(l)] / P;
  }
  return out;
}

template <int P>
Matrix<P> nodes_to_gauss() {
  Matrix<P> out;
  auto const nodes = lobatto_nodes(P - 1);
  auto const rule = gauss_rule(P);
  for (int i = 0; i < P; ++i) {
    auto const values = lagrange_values(nodes, rule.place[std::size_t(i)]);
    for (int l = 0; l < P; ++l) out[i][l] = values[std::size_t(l)];
  }
  return out;
}

template <int P>
Matrix<P> slopes_at_gauss() {
  Matrix<P> out;
  auto const rule = gauss_rule(P);
  for (int i = 0; i < P; ++i) {
    auto const slopes = lagrange_slopes(rule.place, rule.place[std::size_t(i)]);
    for (int l = 0; l < P; ++l) out[i][l] = slopes[std::size_t(l)];
  }
  return out;
}

#define AMRPIC_WITH_NODES(P)                  \
  template Matrix<P> nodes_to_chebyshev<P>(); \
  template Matrix<P> nodes_to_gauss<P>();     \
  template Matrix<P> slopes_at_gauss<P>();
AMRPIC_WITH_NODES(2)
AMRPIC_WITH_NODES(3)
AMRPIC_WITH_NODES(4)
AMRPIC_WITH_NODES(5)
#undef AMRPIC_WITH_NODES

}  // namespace amrpic::fem
