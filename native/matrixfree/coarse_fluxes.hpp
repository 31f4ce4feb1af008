#pragma once

#include <algorithm>
#include <vector>

#include "matrixfree/composite_mesh.hpp"

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

  /// Call f(side, first cell, count, fluxes from the finer level, how far apart these are) for the rows of uncovered
  /// cells with refined cells beyond their faces, side by side, in planes `first` to `last` of a box.
  template <class F>
  void for_each_refined_row(int l, int b, int first, int last, F&& f) const {
    for (int s = mesh_.plan(l, b).refined.first; s < mesh_.plan(l, b).refined.last; ++s) {
      RefinedSide const& r = mesh_.plan(l).refined[std::size_t(s)];
      auto const [u, v] = tangential_axes(r.axis);
      Real const* const fluxes =
          (r.fluxes.here ? of_level_[std::size_t(l) + 1].data() : mesh_.plan(l).finer_fluxes.values()) + r.fluxes.from;
      Index3 cell = r.cells.lower;
      for (cell[2] = std::max(first, r.cells.lower[2]); cell[2] <= std::min(last, r.cells.upper[2]); ++cell[2])
        for (cell[1] = r.cells.lower[1]; cell[1] <= r.cells.upper[1]; ++cell[1])
          f(r, cell, r.cells.extent(0),
            fluxes + std::ptrdiff_t(cell[u] - r.cells.lower[u]) * r.fluxes.pu +
                std::ptrdiff_t(cell[v] - r.cells.lower[v]) * r.fluxes.pv,
            std::ptrdiff_t(r.fluxes.pu));  // along x, where a row has more than one
    }
  }
  /// Call f(side, cell, place in the box, flux from the finer level) for each uncovered cell of a plane and each of its
  /// faces with a refined cell beyond.
  template <class F>
  void for_each_refined(int l, int b, int k, F&& f) const {
    Index3 const pitch = pitches(mesh_.box(l, b));
    for_each_refined_row(
        l, b, k, k, [&](RefinedSide const& r, Index3 cell, int count, Real const* flux, std::ptrdiff_t step) {
          std::ptrdiff_t at = cell[0] + std::ptrdiff_t(cell[1]) * pitch[1] + std::ptrdiff_t(k) * pitch[2];
          for (int x = 0; x < count; ++x, ++cell[0], ++at, flux += step) f(r, cell, at, *flux);
        });
  }

  std::size_t bytes() const;

 private:
  CompositeMesh& mesh_;
  std::vector<std::vector<Real>> of_level_;
};

}  // namespace amrpic
