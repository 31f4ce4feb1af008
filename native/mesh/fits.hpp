// The interpolations of phi* behind coarse-fine faces, by number: they are few, so a face needs to remember no weights.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>

#include "mesh/fits_behind.hpp"
#include "stencil/interface.hpp"

namespace amrpic {

/// The terms of a fit in one of the blocks: cells of the coarse plane, as offsets from the one behind the ghosts along
/// the lower and the higher tangential axis, and the weights of each for the four ghosts.
struct NumberedFit {
  struct Term {
    int i, j;
    FourStars<Real> weight;
  };
  std::array<Term, 9> terms;
  int reach;  ///< largest offset, 1 or 2
};

/// The fit of a number; not of those in gaps.
NumberedFit const& numbered_fit(FitNumber number);

/// phi* of a run of `count` neighbouring coarse cells with the central fit, along the lower tangential axis: two rows
/// of 2 count values. `coarse` points to the first of the cells, its rows are `pitch` apart.
template <class T>
void central_fits(int count, T const* coarse, std::ptrdiff_t pitch, T* lower_row, T* upper_row) {
  constexpr T near = T(parabola_at_quarter[0]), middle = T(parabola_at_quarter[1]), far = T(parabola_at_quarter[2]);
  constexpr int most = 62;
  T lower[most + 2], upper[most + 2];  // the parabolas along the higher axis
  for (int done = 0; done < count; done += most) {
    int const n = std::min(most, count - done);
    T const* c = coarse + done - 1;
    for (int m = 0; m < n + 2; ++m) {
      lower[m] = (near * c[m - pitch] + far * c[m + pitch]) + middle * c[m];
      upper[m] = (far * c[m - pitch] + near * c[m + pitch]) + middle * c[m];
    }
    T *p = lower_row + 2 * done, *q = upper_row + 2 * done;
    for (int m = 0; m < n; ++m) {
      p[2 * m] = (near * lower[m] + far * lower[m + 2]) + middle * lower[m + 1];
      p[2 * m + 1] = (far * lower[m] + near * lower[m + 2]) + middle * lower[m + 1];
      q[2 * m] = (near * upper[m] + far * upper[m + 2]) + middle * upper[m + 1];
      q[2 * m + 1] = (far * upper[m] + near * upper[m + 2]) + middle * upper[m + 1];
    }
  }
}

/// Call f(u, count, fit) for the runs of cells in a row that share a fit, `no_fit` left out.
template <class F>
void for_each_run(FitNumber const* fits, int count, F&& f) {
  for (int u = 0; u < count;) {
    int end = u + 1;
    while (end < count && fits[end] == fits[u]) ++end;
    if (fits[u] != no_fit) f(u, end - u, fits[u]);
    u = end;
  }
}

/// phi* of all ghosts in front of a row of coarse cells along the lower tangential axis, into the two rows of fine
/// ghosts; ghosts of cells with fits in gaps or without any are left as they are. A ghost's value does not depend on
/// the row's extent, not even by rounding.
template <class T>
void fit_row(FitNumber const* fits, int count, T const* coarse, std::ptrdiff_t pitch, T* lower_row, T* upper_row) {
  for_each_run(fits, count, [&](int u, int n, FitNumber number) {
    if (number == fit_in_gap) return;
    if (number == central_fit) return central_fits(n, coarse + u, pitch, lower_row + 2 * u, upper_row + 2 * u);
    NumberedFit const& fit = numbered_fit(number);
    for (int m = u; m < u + n; ++m) {
      FourStars<T> stars{};
      for (auto const& term : fit.terms) add_to_stars(stars, term.weight, coarse[m + term.i + pitch * term.j]);
      std::copy_n(stars[0].data(), 2, lower_row + 2 * m), std::copy_n(stars[1].data(), 2, upper_row + 2 * m);
    }
  });
}

}  // namespace amrpic
