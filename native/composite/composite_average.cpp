#include "composite/composite_average.hpp"

#include <algorithm>
#include <cmath>

#include "base/fused.hpp"

namespace amrpic {

/// Call set(), which writes a plane of cells; covered ones keep the means that they hold.
template <class Set>
void CompositeAverage::set_uncovered(int l, int b, int k, Real* plane, Set&& set) {
  Real* end = covered_.data();
  mesh_.for_each_covered_row(l, b, k, [&](std::ptrdiff_t at, int n) { end = std::copy_n(plane + at, n, end); });
  set();
  Real const* kept = covered_.data();
  mesh_.for_each_covered_row(l, b, k, [&](std::ptrdiff_t at, int n) {
    std::copy_n(kept, n, plane + at);
    kept += n;
  });
}

/// phi += scale * correction in the uncovered cells of a plane.
template <class T>
void CompositeAverage::add_plane(int l, int b, int k, Block<T> const& correction, Real scale, Real* phi,
                                 Largest<T>& largest) {
  int const nx = mesh_.box(l, b).extent(0), ny = mesh_.box(l, b).extent(1);
  set_uncovered(l, b, k, phi, [&] {
    for (int j = 0; j < ny; ++j) {
      T const* __restrict from = correction.origin + j * correction.pitch_y + k * correction.pitch_z;
      Real* __restrict to = phi + std::ptrdiff_t(j) * nx;
      fetch<Use::read>(from + correction.pitch_z, nx);  // rows of a box lie far apart in vectors of the cycle
      fetch<Use::write>(to + page<Real>, nx);
      for (int i = 0; i < nx; ++i) to[i] = fused(scale, Real(from[i]), to[i]);
      largest.add(from, nx);
    }
  });
}

template <class T>
Real CompositeAverage::add(Blocks<T> const& correction, Real scale, Field& phi) {
  Largest<T> largest;
  auto const add_box = [&](int l, int b) {
    Real* const cells = phi.level(l).data() + mesh_.offset(l, b);
    Block<T> const& from = correction[std::size_t(l)][std::size_t(b)];
    for (int k = 0; k < mesh_.box(l, b).extent(2); ++k) {
      // the largest of all cells does not depend on which of the covered ones fill a box
      if (mesh_.plan(l, b).is_fully_covered)
        for (int j = 0; j < mesh_.box(l, b).extent(1); ++j)
          largest.add(from.origin + j * from.pitch_y + k * from.pitch_z, mesh_.box(l, b).extent(0));
      else
        add_plane(l, b, k, from, scale, cells + k * mesh_.box(l, b).stride(2), largest);
      if (l > 0 && k % 2 == 1) mesh_.transfer().average_pair(l, b, k - 1, phi);
    }
  };
  int const finest = mesh_.levels() - 1;
  for (int l = finest; l >= 0; --l) {  // means of finer cells are under way to the boxes that come last
    for (bool last : {false, true}) {
      if (last && l < finest) mesh_.transfer().take_means(l + 1, {&phi});
      for (int b = 0; b < mesh_.boxes(l); ++b)
        if ((l < finest && mesh_.transfer().families(l).is_remote[std::size_t(b)]) == last) add_box(l, b);
    }
    if (l > 0) mesh_.transfer().send_means(l, {&phi});
  }
  mesh_.transfer().settle();
  return std::abs(scale) * largest.value();
}
template Real CompositeAverage::add(Blocks<float> const&, Real, Field&);
template Real CompositeAverage::add(Blocks<Real> const&, Real, Field&);

}  // namespace amrpic
