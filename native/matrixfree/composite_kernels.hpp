// Formulas of the composite Laplacian along one row or plane of a box.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>

#include "base/types.hpp"
#include "mesh/norm.hpp"

namespace amrpic::kernels {

/// a b + c, rounded once where the processor can: in the vector body and the rest of a loop alike.
inline Real fused(Real a, Real b, Real c) {
#ifdef __FMA__
  return __builtin_fma(a, b, c);
#else
  return a * b + c;
#endif
}

/// f - Laplace phi of cells with equal coefficients.
struct Residual {
  Real cx, cy, cz, diagonal;  ///< 1 / h^2 along each axis, and twice their sum
  Real inverse_permittivity, mean;

  Residual(Real3 const& h, Real inverse_permittivity, Real mean)
      : cx(1 / h[0] / h[0]),
        cy(1 / h[1] / h[1]),
        cz(1 / h[2] / h[2]),
        diagonal(2 * (cx + cy + cz)),
        inverse_permittivity(inverse_permittivity),
        mean(mean) {}

  Real right_hand_side(Real rho) const { return fused(-inverse_permittivity, rho, -mean); }
  Real operator()(Real rho, Real c, Real xm, Real xp, Real ym, Real yp, Real zm, Real zp) const {
    Real const sum = fused(cz, zm + zp, fused(cy, ym + yp, cx * (xm + xp)));
    return right_hand_side(rho) - fused(-diagonal, c, sum);
  }
};

/// A row of phi: `cell` in the box, the rows beside it, and the values beyond its ends.
struct Row {
  Real const *cell, *ym, *yp, *zm, *zp;
  Real xm, xp;
};

/// f - Laplace phi along a row of n cells. The row's memory goes on by at least one value before it unless `first`, and
/// after it unless `last`: reading on lets the loop run over whole vectors; what it then finds is put right.
inline void residual_row(Residual const& formula, int n, Row const& row, bool first, bool last,
                         Real const* __restrict rho, Real* __restrict out) {
  Real const *c = row.cell, *ym = row.ym, *yp = row.yp, *zm = row.zm, *zp = row.zp;
  Residual const f = formula;
  for (int i = first ? 1 : 0; i < n - (last ? 1 : 0); ++i)
    out[i] = f(rho[i], c[i], c[i - 1], c[i + 1], ym[i], yp[i], zm[i], zp[i]);
  out[0] = f(rho[0], c[0], row.xm, c[1], ym[0], yp[0], zm[0], zp[0]);
  out[n - 1] = f(rho[n - 1], c[n - 1], c[n - 2], row.xp, ym[n - 1], yp[n - 1], zm[n - 1], zp[n - 1]);
}

/// One rank's part of a norm over cells.
class Magnitude {
 public:
  explicit Magnitude(Norm norm) : norm_(norm) {}

  /// Take in values of cells of equal volume.
  void add(Real const* values, std::ptrdiff_t n, Real volume) {
    if (norm_ == Norm::max) return add_largest(values, n);
    Real lane[8] = {};
    std::ptrdiff_t i = 0;
    auto const size = [this](Real v) { return norm_ == Norm::l1 ? std::abs(v) : v * v; };
    for (; i + 8 <= n; i += 8)
      for (int q = 0; q < 8; ++q) lane[q] += size(values[i + q]);
    for (; i < n; ++i) lane[0] += size(values[i]);
    for (Real part : lane) sum_ += volume * part;
  }

  Real part() const {
    if (norm_ != Norm::max) return sum_;
    Real out;
    std::memcpy(&out, &largest_, sizeof out);
    return out;
  }

 private:
  /// The bits of magnitudes order as whole numbers, infinity and nan above all others.
  void add_largest(Real const* values, std::ptrdiff_t n) {
    std::int64_t largest = largest_;
    for (std::ptrdiff_t i = 0; i < n; ++i) {
      std::int64_t bits;
      std::memcpy(&bits, values + i, sizeof bits);
      bits &= INT64_MAX;
      largest = bits > largest ? bits : largest;
    }
    largest_ = largest;
  }

  Norm norm_;
  std::int64_t largest_ = 0;
  Real sum_ = 0;
};

}  // namespace amrpic::kernels
