#pragma once

#include <array>

#include "base/types.hpp"

namespace amrpic::material {

using Tensor = std::array<std::array<Real, 3>, 3>;

/// Call f(i, j) for each entry.
template <class F>
inline __attribute__((always_inline)) void for_each_entry(F&& f) {
#pragma GCC unroll 3
  for (std::size_t i = 0; i < 3; ++i)
#pragma GCC unroll 3
    for (std::size_t j = 0; j < 3; ++j) f(i, j);
}

inline Tensor unit_tensor(Real by = 1) { return {{{by, 0, 0}, {0, by, 0}, {0, 0, by}}}; }

inline Tensor product(Tensor const& a, Tensor const& b) {
  Tensor out{};
  for_each_entry([&](std::size_t i, std::size_t j) {
    for (std::size_t k = 0; k < 3; ++k) out[i][j] += a[i][k] * b[k][j];
  });
  return out;
}
inline Tensor transposed(Tensor const& a) {
  Tensor out;
  for_each_entry([&](std::size_t i, std::size_t j) { out[i][j] = a[j][i]; });
  return out;
}
/// a + by b
inline Tensor sum(Tensor const& a, Real by, Tensor const& b) {
  Tensor out;
  for_each_entry([&](std::size_t i, std::size_t j) { out[i][j] = a[i][j] + by * b[i][j]; });
  return out;
}
inline Tensor scaled(Real by, Tensor const& a) { return sum({}, by, a); }
inline Tensor symmetric_part(Tensor const& a) { return scaled(Real(0.5), sum(a, 1, transposed(a))); }
inline Real trace(Tensor const& a) { return a[0][0] + a[1][1] + a[2][2]; }
/// Sum of products of entries.
inline Real contraction(Tensor const& a, Tensor const& b) {
  Real out = 0;
  for_each_entry([&](std::size_t i, std::size_t j) { out += a[i][j] * b[i][j]; });
  return out;
}

/// Entries of the inverse times the determinant.
inline Tensor adjugate(Tensor const& a) {
  Tensor out;
  for_each_entry([&](std::size_t i, std::size_t j) {
    std::size_t const r = (j + 1) % 3, s = (j + 2) % 3, p = (i + 1) % 3, q = (i + 2) % 3;
    out[i][j] = a[r][p] * a[s][q] - a[r][q] * a[s][p];
  });
  return out;
}
inline Real determinant(Tensor const& a) {
  auto const of = adjugate(a);
  return a[0][0] * of[0][0] + a[0][1] * of[1][0] + a[0][2] * of[2][0];
}
inline Tensor inverse(Tensor const& a) { return scaled(1 / determinant(a), adjugate(a)); }

/// A symmetric tensor as eigenvalues and eigenvectors, which are the columns of a rotation.
struct Eigen {
  std::array<Real, 3> value;
  Tensor vector;
};
/// By Jacobi's rotations: to rounding, also where values are equal.
Eigen eigen_of(Tensor a);

/// The smallest eigenvalue of a symmetric tensor in closed form: to 1e-8 of the largest where values are equal.
Real smallest_eigenvalue(Tensor const& a);

}  // namespace amrpic::material
