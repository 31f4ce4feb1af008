// One-dimensional bases on [-1, 1]. P = degree + 1 is the number of nodes of an element along an axis.
#pragma once

#include <vector>

#include "base/types.hpp"

namespace amrpic::fem {

/// m[i][l]: what input l adds to output i.
template <int P>
struct Matrix {
  Real row[P][P];
  Real* operator[](int i) { return row[i]; }
  Real const* operator[](int i) const { return row[i]; }
};

template <int P>
Matrix<P> transposed(Matrix<P> const& m) {
  Matrix<P> out;
  for (int i = 0; i < P; ++i)
    for (int l = 0; l < P; ++l) out[l][i] = m[i][l];
  return out;
}

struct Quadrature {
  std::vector<Real> place, weight;
};
/// Gauss's rule of `count` points on [-1, 1], exact to degree 2 count - 1.
Quadrature gauss_rule(int count);

/// The nodes of an element: the ends, and where Legendre's polynomial of this degree has slope zero (Gauss-Lobatto). Up
/// to 4.
std::vector<Real> lobatto_nodes(int degree);

/// Lagrange's polynomial of each node at x, and its slope there.
std::vector<Real> lagrange_values(std::vector<Real> const& nodes, Real x);
std::vector<Real> lagrange_slopes(std::vector<Real> const& nodes, Real x);

/// From values at nodes to Chebyshev coefficients: N_l = sum over i of m[i][l] T_i.
template <int P>
Matrix<P> nodes_to_chebyshev();

/// From values at nodes to those at Gauss's P points, and from these to slopes there.
template <int P>
Matrix<P> nodes_to_gauss();
template <int P>
Matrix<P> slopes_at_gauss();

}  // namespace amrpic::fem
