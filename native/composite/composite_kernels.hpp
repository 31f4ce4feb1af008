// Formulas of the composite Laplacian along one row or plane of a box.
#pragma once

#include <algorithm>
#include <type_traits>

#include "base/fetch.hpp"
#include "stencil/background.hpp"
#include "stencil/laplacian.hpp"

namespace amrpic::kernels {

/// f - L phi of cells of equal size.
struct Residual {
  Equation equation;
  Background background;
  bool in_differences;  ///< see `is_nearly_free`

  template <bool differences>
  KOKKOS_INLINE_FUNCTION Real find(Real rho, Real c, Real xm, Real xp, Real ym, Real yp, Real zm, Real zp) const {
    Real const f = background.right_hand_side(rho);
    if constexpr (differences)
      return f - laplacian<Real>(equation, c, xm, xp, ym, yp, zm, zp);
    else
      return f - laplacian(equation, c, xm, xp, ym, yp, zm, zp);
  }
  KOKKOS_INLINE_FUNCTION Real operator()(Real rho, Real c, Real xm, Real xp, Real ym, Real yp, Real zm, Real zp) const {
    return in_differences ? find<true>(rho, c, xm, xp, ym, yp, zm, zp) : find<false>(rho, c, xm, xp, ym, yp, zm, zp);
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

/// f - L phi of the cells [first, last) of a run; those at the ends of rows take what memory holds beside them
/// for their neighbours along x. So the loop has whole vectors, and the ends are put right afterwards.
/// Not inlined: within a longer function the pointers of the loop do not stay in registers.
[[gnu::noinline]] inline void residual_run(Residual const& formula, std::ptrdiff_t first, std::ptrdiff_t last,
                                           Real const* c, Neighbours const& n, Real const* __restrict rho,
                                           Real* __restrict out) {
  Real const *ym = n.ym, *yp = n.yp, *zm = n.zm, *zp = n.zp;
  Residual const f = formula;
  auto const run = [&](auto differences) {
    for_each_part(first, last, [&](std::ptrdiff_t begin, std::ptrdiff_t end) {
      fetch<Use::read>(rho + begin + page<Real>, end - begin);
      fetch<Use::read>(zp + begin + page<Real>, end - begin);
      for (std::ptrdiff_t i = begin; i < end; ++i)
        out[i] = f.find<differences()>(rho[i], c[i], c[i - 1], c[i + 1], ym[i], yp[i], zm[i], zp[i]);
    });
  };
  f.in_differences ? run(std::true_type()) : run(std::false_type());
}

/// The same of one row of nx cells, only its ends, between the values beyond them.
inline void residual_ends(Residual const& f, int nx, Real const* c, Neighbours const& n, Real xm, Real xp,
                          Real const* rho, Real* out) {
  int const e = nx - 1;
  out[0] = f(rho[0], c[0], xm, c[1], n.ym[0], n.yp[0], n.zm[0], n.zp[0]);
  out[e] = f(rho[e], c[e], c[e - 1], xp, n.ym[e], n.yp[e], n.zm[e], n.zp[e]);
}

}  // namespace amrpic::kernels
