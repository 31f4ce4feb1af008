#include "freespace/solid_harmonics.hpp"

#include <algorithm>
#include <cmath>

#include "freespace/lane_sums.hpp"

namespace amrpic::freespace {

namespace {

/// A polynomial in x, y, z: the numbers before the monomials.
struct Polynomial {
  std::array<double, monomial_count> coefficient{};

  /// Times x^a y^b z^c; what exceeds the order is left out.
  Polynomial times(int a, int b, int c, double factor) const {
    Polynomial out;
    for (int i = 0; i <= order; ++i)
      for (int j = 0; i + j <= order; ++j)
        for (int k = 0; i + j + k <= order; ++k)
          if (i + j + k + a + b + c <= order)
            out.coefficient[monomial_index(i + a, j + b, k + c)] = factor * coefficient[monomial_index(i, j, k)];
    return out;
  }
};

Polynomial operator+(Polynomial a, Polynomial const& b) {
  for (int n = 0; n < monomial_count; ++n) a.coefficient[n] += b.coefficient[n];
  return a;
}

Polynomial times_r2(Polynomial const& p, double factor) {
  return p.times(2, 0, 0, factor) + p.times(0, 2, 0, factor) + p.times(0, 0, 2, factor);
}

/// Re and Im of every R(l, m) as polynomials, by the recurrence of regular_harmonics.
struct HarmonicPolynomials {
  std::array<Polynomial, harmonic_count> re, im;

  HarmonicPolynomials() {
    re[0].coefficient[0] = 1;
    for (int m = 0; m <= order; ++m) {
      if (m > 0) {
        int const before = harmonic_index(m - 1, m - 1);
        double const scale = 1.0 / (2 * m);
        re[harmonic_index(m, m)] = re[before].times(1, 0, 0, scale) + im[before].times(0, 1, 0, -scale);
        im[harmonic_index(m, m)] = im[before].times(1, 0, 0, scale) + re[before].times(0, 1, 0, scale);
      }
      for (int l = m + 1; l <= order; ++l) {
        double const scale = 1.0 / (l * l - m * m);
        for (auto* part : {&re, &im}) {
          Polynomial& p = (*part)[harmonic_index(l, m)];
          p = (*part)[harmonic_index(l - 1, m)].times(0, 0, 1, (2 * l - 1) * scale);
          if (l > m + 1) p = p + times_r2((*part)[harmonic_index(l - 2, m)], -scale);
        }
      }
    }
  }
};

}  // namespace

Harmonics<double> reflected(Harmonics<double> const& moments, std::array<bool, 3> const& axes, double factor) {
  Harmonics<double> out;
  for (int l = 0; l <= order; ++l)
    for (int m = 0; m <= l; ++m) {
      bool const turns = (axes[0] && m % 2 == 1) != (axes[2] && (l + m) % 2 == 1);
      double const sign = turns ? -factor : factor;
      Complex<double> const& value = moments[harmonic_index(l, m)];
      out[harmonic_index(l, m)] = {sign * value.re, axes[0] != axes[1] ? -sign * value.im : sign * value.im};
    }
  return out;
}

double degree_strength(Harmonics<double> const& moments, int l) {
  // Schwarz' inequality: sum over m = -l .. l of |S(l, m)|^2 / ((l - m)! (l + m)!) is r^(-2 l - 2).
  double largest = 0;  // moments may be so small or large that their squares are no doubles
  for (int m = 0; m <= l; ++m) {
    Complex<double> const& value = moments[harmonic_index(l, m)];
    largest = std::max({largest, std::abs(value.re), std::abs(value.im)});
  }
  if (largest == 0) return 0;
  double sum = 0, factor = 1;  // (l - m)! (l + m)!
  for (int n = 2; n <= l; ++n) factor *= n * n;
  for (int m = 0; m <= l; ++m) {
    if (m > 0) factor *= double(l + m) / (l - m + 1);
    Complex<double> const& value = moments[harmonic_index(l, m)];
    double const re = value.re / largest, im = value.im / largest;
    sum += (m > 0 ? 2 : 1) * factor * (re * re + im * im);
  }
  return largest * std::sqrt(sum);
}

Expansion to_expansion(Harmonics<double> const& moments) {
  Expansion out;
  double double_factorial = 1;  // (2m - 1)!!
  for (int m = 0; m <= order; ++m) {
    if (m > 0) double_factorial *= 2 * m - 1;
    double scale = m > 0 ? 2 * double_factorial : 1;
    for (int l = m; l <= order; ++l) {
      if (l > m) scale *= 2 * l - 1;
      Complex<double> const& value = moments[harmonic_index(l, m)];
      out[expansion_index(l, m)] = scale * value.re;
      if (m > 0) out[expansion_index(l, m) + 1] = scale * value.im;
    }
  }
  return out;
}

std::array<double, monomial_count> block_monomials(double const* charges, BlockPowers const& powers) {
  std::array<double, monomial_count> out;
  for (int c = 0; c <= order; ++c) {
    Lanes along_z[8] = {};
    for (int k = 0; k < 8; ++k)
      for (int j = 0; j < 8; ++j) {
        auto const row = load<Lanes>(charges + 8 * (8 * k + j));
        along_z[j] += row * powers[2][c][k];
      }
    for (int b = 0; b + c <= order; ++b) {
      Lanes along_y{};
      for (int j = 0; j < 8; ++j) along_y += along_z[j] * powers[1][b][j];
      for (int a = 0; a + b + c <= order; ++a) {
        auto const power = load<Lanes>(powers[0][a].data());
        out[monomial_index(a, b, c)] = sum_of(along_y * power);
      }
    }
  }
  return out;
}

namespace {

/// What each monomial adds to the moments R(l, m) of its degree l, m = 0 .. l in the lanes.
struct MonomialColumns {
  std::array<std::array<double, lane_count>, monomial_count> re{}, im{};

  MonomialColumns() {
    HarmonicPolynomials const polynomials;
    for (int l = 0; l <= order; ++l)
      for (int m = 0; m <= l; ++m)
        for (int n = 0; n < monomial_count; ++n) {
          // R(l, m) is homogeneous: only the monomials of degree l take part.
          if (n < monomial_index(l, 0, 0) || n > monomial_index(0, 0, l)) continue;
          re[n][m] = polynomials.re[harmonic_index(l, m)].coefficient[n];
          im[n][m] = polynomials.im[harmonic_index(l, m)].coefficient[n];
        }
  }
};

}  // namespace

Harmonics<double> moments_of(std::array<double, monomial_count> const& monomials) {
  static MonomialColumns const columns;
  Harmonics<double> out;
  for (int l = 0; l <= order; ++l) {
    Lanes re{}, im{};
    for (int n = monomial_index(l, 0, 0); n <= monomial_index(0, 0, l); ++n) {
      re += load<Lanes>(columns.re[n].data()) * monomials[n];
      im += load<Lanes>(columns.im[n].data()) * monomials[n];
    }
    for (int m = 0; m <= l; ++m) out[harmonic_index(l, m)] = {re[m], im[m]};
  }
  return out;
}

}  // namespace amrpic::freespace
