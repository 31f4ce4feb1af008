// Multipoles of a box of charges: moments, their translation, and the potential they make far away.
//
// Regular harmonics R(l, m) and singular harmonics S(l, m), l <= order, without the Condon-Shortley sign. For charges q
// at y and a centre c the moments are M(l, m) = sum q R(l, m)(y - c), and
//   sum q / (4 pi |x - y|) = 1 / (4 pi) sum_l { M(l, 0) S(l, 0) + 2 sum_{m > 0} Re[conj(M(l, m)) S(l, m)(x - c)] }.
#pragma once

#include <algorithm>
#include <array>

namespace amrpic::freespace {

constexpr int order = 6;                                                     ///< highest l
constexpr int harmonic_count = (order + 1) * (order + 2) / 2;                ///< pairs (l, m) with 0 <= m <= l
constexpr int monomial_count = (order + 1) * (order + 2) * (order + 3) / 6;  ///< x^a y^b z^c with a + b + c <= order
constexpr int moment_count = (order + 1) * (order + 1);                      ///< real numbers in a set of moments

/// Place of the pair (l, m), m >= 0.
constexpr int harmonic_index(int l, int m) { return l * (l + 1) / 2 + m; }

/// Place of x^a y^b z^c: by degree, so that the monomials of a degree are neighbours.
constexpr int monomial_index(int a, int b, int c) {
  int const degree = a + b + c, rest = b + c;
  return degree * (degree + 1) * (degree + 2) / 6 + rest * (rest + 1) / 2 + c;
}

template <class T>
struct Complex {
  T re, im;
};

/// Values for all (l, m), m >= 0.
template <class T>
using Harmonics = std::array<Complex<T>, harmonic_count>;

/// R(l, m) at (x, y, z).
template <class T>
Harmonics<T> regular_harmonics(T const& x, T const& y, T const& z) {
  Harmonics<T> out;
  T const r2 = x * x + y * y + z * z;
  out[0] = {T{} + 1.0, T{}};
  for (int m = 0; m <= order; ++m) {
    auto const at = [&out, m](int l) -> Complex<T>& { return out[harmonic_index(l, m)]; };
    if (m > 0) {
      Complex<T> const& before = out[harmonic_index(m - 1, m - 1)];
      at(m) = {(x * before.re - y * before.im) / (2.0 * m), (x * before.im + y * before.re) / (2.0 * m)};
    }
    if (m < order) at(m + 1) = {z * at(m).re, z * at(m).im};
    for (int l = m + 2; l <= order; ++l) {
      double const scale = 1.0 / (l * l - m * m);
      T const a = (2 * l - 1) * scale * z, b = scale * r2;
      at(l) = {a * at(l - 1).re - b * at(l - 2).re, a * at(l - 1).im - b * at(l - 2).im};
    }
  }
  return out;
}

/// A value for (l, m) of either sign of m: R(l, -m) = (-1)^m conj R(l, m), and the same for moments.
template <class T>
Complex<T> with_sign(Harmonics<T> const& values, int l, int m) {
  if (m >= 0) return values[harmonic_index(l, m)];
  Complex<T> const& v = values[harmonic_index(l, -m)];
  return m % 2 == 0 ? Complex<T>{v.re, -1.0 * v.im} : Complex<T>{-1.0 * v.re, v.im};
}

/// Moments about a new centre, of charges whose moments about the old one are given; (x, y, z) points from new to old.
/// Exact: R(l, m)(a + b) = sum_{j, k} R(j, k)(b) R(l - j, m - k)(a).
template <class T>
Harmonics<T> translate_moments(Harmonics<T> const& moments, T const& x, T const& y, T const& z) {
  std::array<Complex<T>, moment_count> old, shift;  // of either sign of m, at l (l + 1) + m
  Harmonics<T> const regular = regular_harmonics(x, y, z);
  for (int l = 0; l <= order; ++l)
    for (int m = -l; m <= l; ++m) {
      old[l * (l + 1) + m] = with_sign(moments, l, m);
      shift[l * (l + 1) + m] = with_sign(regular, l, m);
    }
  Harmonics<T> out;
  for (int l = 0; l <= order; ++l)
    for (int m = 0; m <= l; ++m) {
      Complex<T> sum = moments[harmonic_index(l, m)];
      for (int j = 0; j < l; ++j) {
        int const i = l - j;
        Complex<T> const *a = &old[j * (j + 1)], *b = &shift[i * (i + 1) + m];
        for (int k = std::max(-j, m - i); k <= std::min(j, m + i); ++k) {
          sum.re += a[k].re * b[-k].re - a[k].im * b[-k].im;
          sum.im += a[k].re * b[-k].im + a[k].im * b[-k].re;
        }
      }
      out[harmonic_index(l, m)] = sum;
    }
  return out;
}

/// Moments of the charges reflected along some axes, about the reflected centre, times a factor.
Harmonics<double> reflected(Harmonics<double> const& moments, std::array<bool, 3> const& axes, double factor);

/// A: what the moments of degree l add to 4 pi times the potential at distance r is at most A / r^(l + 1).
double degree_strength(Harmonics<double> const& moments, int l);

/// Moments as `multipole_potential` uses them: by m, then l; real and imaginary part for m > 0; scaled so that the
/// polynomials of its recurrence are monic in z.
using Expansion = std::array<double, moment_count>;
Expansion to_expansion(Harmonics<double> const& moments);

/// Place of (l, m) in an expansion; the imaginary part, for m > 0, comes next.
constexpr int expansion_index(int l, int m) {
  return m == 0 ? l : (order + 1) + (m - 1) * (2 * (order + 1) - m) + 2 * (l - m);
}

/// 4 pi times the potential of an expansion up to `highest` at (dx, dy, dz) from its centre; `inverse_r`: 1 / distance.
/// No number at the centre.
///
/// S(l, m) = T(l) S(m, m) with T(l) real: T(m) = 1, T(l + 1) = (2l + 1) z T(l) - (l^2 - m^2) / r^2 T(l - 1), and z for
/// z / r^2. Here T is divided by (2l - 1) (2l - 3) .. (2m + 1).
template <int highest, class T>
inline T multipole_potential(Expansion const& moments, T const& dx, T const& dy, T const& dz, T const& inverse_r) {
  T const inverse_r2 = inverse_r * inverse_r;
  T const x = dx * inverse_r2, y = dy * inverse_r2, z = dz * inverse_r2;
  T diagonal_re = inverse_r, diagonal_im{}, sum{};  // S(m, m) / (2m - 1)!!
#pragma GCC unroll 8
  for (int m = 0; m <= highest; ++m) {
    double const* a = moments.data() + expansion_index(m, m);
    T value = T{} + 1.0, before{}, re{}, im{};
#pragma GCC unroll 8
    for (int l = m; l <= highest; ++l) {
      re += *a++ * value;
      if (m > 0) im += *a++ * value;
      T const next = z * value - (double(l * l - m * m) / (4 * l * l - 1)) * inverse_r2 * before;
      before = value, value = next;
    }
    sum += m > 0 ? re * diagonal_re + im * diagonal_im : re * diagonal_re;
    T const next = x * diagonal_re - y * diagonal_im;
    diagonal_im = x * diagonal_im + y * diagonal_re;
    diagonal_re = next;
  }
  return sum;
}

/// sum q x^a y^b z^c over a block of 8 x 8 x 8 charges, x fastest, by three contractions along one axis each.
/// `powers[d][n][i]`: coordinate i along axis d to the power n.
using BlockPowers = std::array<std::array<std::array<double, 8>, order + 1>, 3>;
std::array<double, monomial_count> block_monomials(double const* charges, BlockPowers const& powers);

/// Moments M(l, m) from the sums of the monomials: a constant linear map.
Harmonics<double> moments_of(std::array<double, monomial_count> const& monomials);

}  // namespace amrpic::freespace
