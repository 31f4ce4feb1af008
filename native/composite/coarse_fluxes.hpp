#pragma once

#include <algorithm>
#include <vector>

#include "composite/composite_mesh.hpp"

namespace amrpic {

/// What each level sends through its coarse faces, so that each face has one flux: of each coarse cell behind an
/// interface the sum of the four fine differences in front of it.
class CoarseFluxes {
 public:
  explicit CoarseFluxes(CompositeMesh& mesh);

  /// Those of a row of coarse cells behind an interface of a level.
  Real* row(int l, Interface const& i, int v) {
    return of_level_[std::size_t(l)].data() + i.fluxes + std::ptrdiff_t(v) * i.nu;
  }
  /// Send those of a level to the ranks of the cells behind it; `finish` waits for those from the next finer level, and
  /// `settle` for others to have those of all levels.
  void send(int l);
  void finish(int l) { mesh_.plan(l).finer_fluxes.finish(); }
  void settle() {
    for (int l = 0; l < mesh_.levels(); ++l) mesh_.plan(l).finer_fluxes.settle();
  }

  /// Call f(side, fluxes) for the sides of a box with refined cells beyond; the fluxes are those from the finer level,
  /// of the side's first cell first, as far apart along its tangential axes as `side.fluxes` has them.
  template <class F>
  void for_each_refined_side(int l, int b, F&& f) const {
    for (int s = mesh_.plan(l, b).refined.first; s < mesh_.plan(l, b).refined.last; ++s) {
      RefinedSide const& r = mesh_.plan(l).refined[std::size_t(s)];
      f(r, of(l, r));
    }
  }
  /// Those through a side of a box of a level.
  Real const* of(int l, RefinedSide const& r) const {
    return (r.fluxes.here ? of_level_[std::size_t(l) + 1].data() : mesh_.plan(l).finer_fluxes.values()) + r.fluxes.from;
  }
  /// Call f(side, first cell, count, fluxes, how far apart these are) for the rows of cells on such sides, side by
  /// side, in planes `first` to `last` of a box.
  template <class F>
  void for_each_refined_row(int l, int b, int first, int last, F&& f) const {
    for_each_refined_side(l, b, [&](RefinedSide const& r, Real const* fluxes) {
      auto const [u, v] = tangential_axes(r.axis);
      Index3 cell = r.cells.lower;
      for (cell[2] = std::max(first, r.cells.lower[2]); cell[2] <= std::min(last, r.cells.upper[2]); ++cell[2])
        for (cell[1] = r.cells.lower[1]; cell[1] <= r.cells.upper[1]; ++cell[1])
          f(r, cell, r.cells.extent(0),
            fluxes + std::ptrdiff_t(cell[u] - r.cells.lower[u]) * r.fluxes.pu +
                std::ptrdiff_t(cell[v] - r.cells.lower[v]) * r.fluxes.pv,
            std::ptrdiff_t(r.fluxes.pu));  // along x, where a row has more than one
    });
  }

  std::size_t bytes() const;

 private:
  CompositeMesh& mesh_;
  std::vector<std::vector<Real>> of_level_;
};

}  // namespace amrpic
