#include "matrixfree/composite_average.hpp"

#include <algorithm>
#include <cmath>

#include "base/fused.hpp"
#include "mesh/means.hpp"

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

/// Set the parents of planes k and k + 1 of a box that are cells of this rank to the mean of their children.
void CompositeAverage::average_pair(int l, int b, int k, Field& phi) const {
  Index3 const pitch = mesh_.box(l, b).strides();
  Real const* const cells = phi.level(l).data() + mesh_.offset(l, b) + std::ptrdiff_t(k) * pitch[2];
  for (int f = mesh_.plan(l, b).families.first; f < mesh_.plan(l, b).families.last; ++f) {
    Family const& family = mesh_.plan(l).families[std::size_t(f)];
    int const plane = (k - family.child[2]) / 2;
    if (k < family.child[2] || plane >= family.parents[2]) continue;
    Real* parent = phi.level(l - 1).data() + family.parent + std::ptrdiff_t(plane) * family.pitch_z;
    Real const* child = cells + family.child[0] + std::ptrdiff_t(family.child[1]) * pitch[1];
    for (int j = 0; j < family.parents[1]; ++j, parent += family.pitch_y, child += 2 * std::ptrdiff_t(pitch[1]))
      average_children(family.parents[0], child, pitch[1], pitch[2], parent);
  }
}

/// Send other ranks the means of children on level l.
void CompositeAverage::send_means(int l, Field const& phi) {
  mesh_.plan(l - 1).finer_means.start([&](int, Read const& read, Real* out) {
    Box const &own = mesh_.level(l).box(read.owner), part = read.cells();
    Index3 const pitch = own.strides();
    Real const* const cells = phi.level(l).data() + mesh_.level(l).local_offset(read.owner);
    for_each_row(part, [&](Index3 const& parent) {
      average_children(part.extent(0), cells + own.offset(first_child_of(parent)), pitch[1], pitch[2], out);
      out += part.extent(0);
    });
  });
}

/// Set the parents on this rank of other ranks' cells of level l.
void CompositeAverage::take_means(int l, Field& phi) {
  LevelPlan& coarse = mesh_.plan(l - 1);
  coarse.finer_means.finish();
  for (RemoteMeans const& m : coarse.remote_means) {
    Real const* from = coarse.finer_means.values() + m.from;
    for (int k = 0; k < m.parents[2]; ++k)
      for (int j = 0; j < m.parents[1]; ++j, from += m.parents[0])
        std::copy_n(from, m.parents[0],
                    phi.level(l - 1).data() + m.parent + std::ptrdiff_t(j) * m.pitch_y + std::ptrdiff_t(k) * m.pitch_z);
  }
}

void CompositeAverage::settle() {
  for (int l = 0; l < mesh_.levels(); ++l) mesh_.plan(l).finer_means.settle();
}

void CompositeAverage::average_down(Field& phi) {
  for (int l = mesh_.levels() - 1; l > 0; --l) {
    for (int b = 0; b < mesh_.boxes(l); ++b)
      for (int k = 0; k < mesh_.box(l, b).extent(2); k += 2) average_pair(l, b, k, phi);
    send_means(l, phi);
    take_means(l, phi);
  }
  settle();
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
      if (l > 0 && k % 2 == 1) average_pair(l, b, k - 1, phi);
    }
  };
  int const finest = mesh_.levels() - 1;
  for (int l = finest; l >= 0; --l) {  // means of finer cells are under way to the boxes that come last
    for (bool last : {false, true}) {
      if (last && l < finest) take_means(l + 1, phi);
      for (int b = 0; b < mesh_.boxes(l); ++b)
        if (mesh_.plan(l, b).takes_means == last) add_box(l, b);
    }
    if (l > 0) send_means(l, phi);
  }
  settle();
  return std::abs(scale) * largest.value();
}
template Real CompositeAverage::add(Blocks<float> const&, Real, Field&);
template Real CompositeAverage::add(Blocks<Real> const&, Real, Field&);

}  // namespace amrpic
