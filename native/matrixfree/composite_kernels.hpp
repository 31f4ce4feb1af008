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

/// Where the neighbours of a run of cells lie that are contiguous in memory.
struct Neighbours {
  Real const *ym, *yp, *zm, *zp;
};

/// f - Laplace phi of the cells [first, last) of a run; those at the ends of rows take what memory holds beside them
/// for their neighbours along x. So the loop has whole vectors, and the ends are put right afterwards.
inline void residual_run(Residual const& formula, std::ptrdiff_t first, std::ptrdiff_t last, Real const* c,
                         Neighbours const& n, Real const* __restrict rho, Real* __restrict out) {
  Real const *ym = n.ym, *yp = n.yp, *zm = n.zm, *zp = n.zp;
  Residual const f = formula;
  for (std::ptrdiff_t i = first; i < last; ++i)
    out[i] = f(rho[i], c[i], c[i - 1], c[i + 1], ym[i], yp[i], zm[i], zp[i]);
}

/// The same of one row of nx cells, only its ends, between the values beyond them.
inline void residual_ends(Residual const& f, int nx, Real const* c, Neighbours const& n, Real xm, Real xp,
                          Real const* rho, Real* out) {
  int const e = nx - 1;
  out[0] = f(rho[0], c[0], xm, c[1], n.ym[0], n.yp[0], n.zm[0], n.zp[0]);
  out[e] = f(rho[e], c[e], c[e - 1], xp, n.ym[e], n.yp[e], n.zm[e], n.zp[e]);
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
    std::int64_t largest[16] = {};  // side by side, so that none waits for another
    std::ptrdiff_t i = 0;
    for (; i + 16 <= n; i += 16)
      for (int q = 0; q < 16; ++q) largest[q] = std::max(largest[q], magnitude_bits(values[i + q]));
    for (; i < n; ++i) largest[0] = std::max(largest[0], magnitude_bits(values[i]));
    for (std::int64_t part : largest) largest_ = std::max(largest_, part);
  }
  static std::int64_t magnitude_bits(Real value) {
    std::int64_t bits;
    std::memcpy(&bits, &value, sizeof bits);
    return bits & INT64_MAX;
  }

  Norm norm_;
  std::int64_t largest_ = 0;
  Real sum_ = 0;
};

}  // namespace amrpic::kernels
