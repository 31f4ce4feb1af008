// What a polynomial on an element is at points, and the opposite: from points to its coefficients.
//
// u(x, y, z) = sum of c[i, j, k] R_i(x) R_j(y) R_k(z), x fastest. The rows R are Chebyshev polynomials, whose first one
// is 1 and whose second one has the slope 1: products with these are left out. Nothing else is assumed of V than sums
// and products: it is a vector, of one number for each of some points.
#pragma once

#include "base/lane_types.hpp"

namespace amrpic::fem {

/// Values and slopes of P one-dimensional functions at a point.
template <int P, class V>
struct Rows {
  V value[P], slope[P];
};

/// T_0 to T_p at `x`, by recurrence.
template <int P, class V>
inline Rows<P, V> chebyshev_rows(V const& x) {
  Rows<P, V> out;
  V const two_x = x + x;
  out.value[0] = V{} + NumberOf<V>(1), out.slope[0] = V{};
  out.value[1] = x, out.slope[1] = out.value[0];
#pragma GCC unroll 5
  for (int n = 2; n < P; ++n) {
    out.value[n] = two_x * out.value[n - 1] - out.value[n - 2];
    out.slope[n] = two_x * out.slope[n - 1] + (out.value[n - 1] + out.value[n - 1]) - out.slope[n - 2];
  }
  return out;
}

/// Whether R_0 = 1 and R_1' = 1.
enum class Basis { chebyshev, any };

/// to += by R_n.
template <Basis basis, int P, class A, class V>
inline __attribute__((always_inline)) void accumulate_value(int n, V& to, A const& by, Rows<P, V> const& rows) {
  if (basis == Basis::chebyshev && n == 0)
    to += by;
  else
    to += by * rows.value[n];
}
/// to += by R_n'.
template <Basis basis, int P, class A, class V>
inline __attribute__((always_inline)) void accumulate_slope(int n, V& to, A const& by, Rows<P, V> const& rows) {
  if (basis == Basis::chebyshev && n == 0) return;
  if (basis == Basis::chebyshev && n == 1)
    to += by;
  else
    to += by * rows.slope[n];
}
/// to = by R_n.
template <Basis basis, int P, class A, class V>
inline __attribute__((always_inline)) void set_value(int n, V& to, A const& by, Rows<P, V> const& rows) {
  if (basis == Basis::chebyshev && n == 0)
    to = by - V{};
  else
    to = by * rows.value[n];
}
/// to = by R_n'.
template <Basis basis, int P, class A, class V>
inline __attribute__((always_inline)) void set_slope(int n, V& to, A const& by, Rows<P, V> const& rows) {
  if (basis == Basis::chebyshev && n == 0)
    to = V{};
  else if (basis == Basis::chebyshev && n == 1)
    to = by - V{};
  else
    to = by * rows.slope[n];
}
/// A term of a sum, whose first one sets it: by R_n, by R_n'.
template <Basis basis, int P, class A, class V>
inline __attribute__((always_inline)) void add_value(int n, V& to, A const& by, Rows<P, V> const& rows) {
  if (n == 0)
    set_value<basis>(n, to, by, rows);
  else
    accumulate_value<basis>(n, to, by, rows);
}
template <Basis basis, int P, class A, class V>
inline __attribute__((always_inline)) void add_slope(int n, V& to, A const& by, Rows<P, V> const& rows) {
  if (n == (basis == Basis::chebyshev ? 1 : 0))
    set_slope<basis>(n, to, by, rows);
  else
    accumulate_slope<basis>(n, to, by, rows);
}

/// What a polynomial is at a point.
template <Basis basis, int P, class V>
inline __attribute__((always_inline)) V value_at(NumberOf<V> const* c, Vector3<Rows<P, V>> const& rows) {
  V out;
#pragma GCC unroll 5
  for (int k = 0; k < P; ++k) {
    V of_plane;
#pragma GCC unroll 5
    for (int j = 0; j < P; ++j) {
      V of_line;
#pragma GCC unroll 5
      for (int i = 0; i < P; ++i) add_value<basis>(i, of_line, c[i + P * (j + P * k)], rows[0]);
      add_value<basis>(j, of_plane, of_line, rows[1]);
    }
    add_value<basis>(k, out, of_plane, rows[2]);
  }
  return out;
}

/// Its slopes.
template <Basis basis, int P, class V>
inline __attribute__((always_inline)) Vector3<V> gradient_at(NumberOf<V> const* c, Vector3<Rows<P, V>> const& rows) {
  V x, y, z;
#pragma GCC unroll 5
  for (int k = 0; k < P; ++k) {
    V plane, plane_x, plane_y;
#pragma GCC unroll 5
    for (int j = 0; j < P; ++j) {
      V line, line_x;
#pragma GCC unroll 5
      for (int i = 0; i < P; ++i) {
        NumberOf<V> const coefficient = c[i + P * (j + P * k)];
        add_value<basis>(i, line, coefficient, rows[0]);
        add_slope<basis>(i, line_x, coefficient, rows[0]);
      }
      add_value<basis>(j, plane, line, rows[1]);
      add_value<basis>(j, plane_x, line_x, rows[1]);
      add_slope<basis>(j, plane_y, line, rows[1]);
    }
    add_value<basis>(k, x, plane_x, rows[2]);
    add_value<basis>(k, y, plane_y, rows[2]);
    add_slope<basis>(k, z, plane, rows[2]);
  }
  return {x, y, z};
}

/// Add `value` times each of the P^3 products of values to `sums`.
template <Basis basis, int P, class V>
inline __attribute__((always_inline)) void add_by_value(V const& value, Vector3<Rows<P, V>> const& rows, V* sums) {
#pragma GCC unroll 5
  for (int k = 0; k < P; ++k) {
    V plane;
    set_value<basis>(k, plane, value, rows[2]);
#pragma GCC unroll 5
    for (int j = 0; j < P; ++j) {
      V line;
      set_value<basis>(j, line, plane, rows[1]);
#pragma GCC unroll 5
      for (int i = 0; i < P; ++i) accumulate_value<basis>(i, sums[i + P * (j + P * k)], line, rows[0]);
    }
  }
}

/// Add the scalar product of `flux` and the slopes of each of the P^3 products of values to `sums`.
template <Basis basis, int P, class V>
inline __attribute__((always_inline)) void add_by_gradient(Vector3<V> const& flux, Vector3<Rows<P, V>> const& rows,
                                                           V* sums) {
#pragma GCC unroll 5
  for (int k = 0; k < P; ++k) {
    V plane, plane_x, plane_y;  // what multiplies values of x and y; slopes of x; slopes of y
    set_value<basis>(k, plane_x, flux[0], rows[2]);
    set_value<basis>(k, plane_y, flux[1], rows[2]);
    set_slope<basis>(k, plane, flux[2], rows[2]);
#pragma GCC unroll 5
    for (int j = 0; j < P; ++j) {
      V line, line_x;
      set_value<basis>(j, line, plane, rows[1]);
      accumulate_slope<basis>(j, line, plane_y, rows[1]);
      set_value<basis>(j, line_x, plane_x, rows[1]);
#pragma GCC unroll 5
      for (int i = 0; i < P; ++i) {
        V& sum = sums[i + P * (j + P * k)];
        accumulate_value<basis>(i, sum, line, rows[0]);
        accumulate_slope<basis>(i, sum, line_x, rows[0]);
      }
    }
  }
}

/// Rows of the nodes' own functions, multiplied in pairs: N N, N N', N' N'.
template <int P, class V>
struct PairedRows {
  V values[P], mixed[P], slopes[P];
};

/// Add g' K g of each of the P^3 products of values to `sums`, where g are its slopes, and `value` times its square.
template <int P, class V>
inline void add_squares(V const& value, std::array<Vector3<V>, 3> const& k, Vector3<PairedRows<P, V>> const& rows,
                        V* sums) {
  V const xy = k[0][1] + k[1][0], xz = k[0][2] + k[2][0], yz = k[1][2] + k[2][1];
  for (int z = 0, n = 0; z < P; ++z) {
    V const none = value * rows[2].values[z] + k[2][2] * rows[2].slopes[z];
    V const of_x = xz * rows[2].mixed[z], of_y = yz * rows[2].mixed[z];
    V const of_xx = k[0][0] * rows[2].values[z], of_xy = xy * rows[2].values[z], of_yy = k[1][1] * rows[2].values[z];
    for (int y = 0; y < P; ++y) {
      V const line = none * rows[1].values[y] + of_y * rows[1].mixed[y] + of_yy * rows[1].slopes[y];
      V const line_x = of_x * rows[1].values[y] + of_xy * rows[1].mixed[y], line_xx = of_xx * rows[1].values[y];
      for (int x = 0; x < P; ++x, ++n)
        sums[n] += line * rows[0].values[x] + line_x * rows[0].mixed[x] + line_xx * rows[0].slopes[x];
    }
  }
}

}  // namespace amrpic::fem
