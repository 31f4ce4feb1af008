// Formulas of the composite Laplacian along one row or plane of a box.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <type_traits>

#include "base/fetch.hpp"
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

/// Call f(begin, end) for parts of a run that are a few cache lines long.
template <class F>
inline void for_each_part(std::ptrdiff_t first, std::ptrdiff_t last, F&& f) {
  constexpr std::ptrdiff_t part = 64;
  for (; first < last; first += part) f(first, std::min(last, first + part));
}

/// f - Laplace phi of the cells [first, last) of a run; those at the ends of rows take what memory holds beside them
/// for their neighbours along x. So the loop has whole vectors, and the ends are put right afterwards.
inline void residual_run(Residual const& formula, std::ptrdiff_t first, std::ptrdiff_t last, Real const* c,
                         Neighbours const& n, Real const* __restrict rho, Real* __restrict out) {
  Real const *ym = n.ym, *yp = n.yp, *zm = n.zm, *zp = n.zp;
  Residual const f = formula;
  for_each_part(first, last, [&](std::ptrdiff_t begin, std::ptrdiff_t end) {
    fetch<Use::read>(rho + begin + page<Real>, end - begin);
    fetch<Use::read>(zp + begin + page<Real>, end - begin);
    for (std::ptrdiff_t i = begin; i < end; ++i)
      out[i] = f(rho[i], c[i], c[i - 1], c[i + 1], ym[i], yp[i], zm[i], zp[i]);
  });
}

/// The same of one row of nx cells, only its ends, between the values beyond them.
inline void residual_ends(Residual const& f, int nx, Real const* c, Neighbours const& n, Real xm, Real xp,
                          Real const* rho, Real* out) {
  int const e = nx - 1;
  out[0] = f(rho[0], c[0], xm, c[1], n.ym[0], n.yp[0], n.zm[0], n.zp[0]);
  out[e] = f(rho[e], c[e], c[e - 1], xp, n.ym[e], n.yp[e], n.zm[e], n.zp[e]);
}

/// A running maximum of magnitudes. The bits of magnitudes order as whole numbers, infinity and nan above all others.
template <class T>
class Largest {
 public:
  static constexpr int lanes = 16;  // side by side, so that none waits for another

  void add(T const* values, std::ptrdiff_t n) {
    Bits largest[lanes] = {};
    std::ptrdiff_t i = 0;
    for (; i + lanes <= n; i += lanes)
      for (int q = 0; q < lanes; ++q) largest[q] = std::max(largest[q], bits(values[i + q]));
    for (; i < n; ++i) largest[0] = std::max(largest[0], bits(values[i]));
    for (Bits part : largest) largest_ = std::max(largest_, part);
  }
  T value() const {
    T out;
    std::memcpy(&out, &largest_, sizeof out);
    return out;
  }

 private:
  using Bits = std::conditional_t<sizeof(T) == 4, std::int32_t, std::int64_t>;
  static Bits bits(T value) {
    Bits out;
    std::memcpy(&out, &value, sizeof out);
    return out & std::numeric_limits<Bits>::max();
  }

  Bits largest_ = 0;
};

/// One rank's part of a norm over cells.
class Magnitude {
 public:
  explicit Magnitude(Norm norm) : norm_(norm) {}

  /// Take in values of cells of equal volume.
  void add(Real const* values, std::ptrdiff_t n, Real volume) {
    if (norm_ == Norm::max) return largest_.add(values, n);
    Real lane[8] = {};
    std::ptrdiff_t i = 0;
    auto const size = [this](Real v) { return norm_ == Norm::l1 ? std::abs(v) : v * v; };
    for (; i + 8 <= n; i += 8)
      for (int q = 0; q < 8; ++q) lane[q] += size(values[i + q]);
    for (; i < n; ++i) lane[0] += size(values[i]);
    for (Real part : lane) sum_ += volume * part;
  }

  Real part() const { return norm_ == Norm::max ? largest_.value() : sum_; }

 private:
  Norm norm_;
  Largest<Real> largest_;
  Real sum_ = 0;
};

}  // namespace amrpic::kernels
