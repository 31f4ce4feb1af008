#pragma once

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
  /// Send those of a level to the ranks of the cells behind it; `finish` waits for those from the next finer level.
  void send(int l);
  void finish(int l) { mesh_.plan(l).finer_fluxes.finish(); }

  /// Call f(side, cell, place in the box, flux from the finer level) for each uncovered cell of a plane and each of its
  /// faces with a refined cell beyond. `zero`: all fluxes are, and none need have been sent.
  template <class F>
  void for_each_refined(int l, int b, int k, bool zero, F&& f) const {
    Index3 const pitch = pitches(mesh_.box(l, b));
    for (int s = mesh_.plan(l, b).refined.first; s < mesh_.plan(l, b).refined.last; ++s) {
      RefinedSide const& r = mesh_.plan(l).refined[std::size_t(s)];
      if (k < r.cells.lower[2] || k > r.cells.upper[2]) continue;
      auto const [u, v] = tangential_axes(r.axis);
      Real const* const fluxes =
          zero ? nullptr
               : (r.fluxes.here ? of_level_[std::size_t(l) + 1].data() : mesh_.plan(l).finer_fluxes.values()) +
                     r.fluxes.from;
      Index3 cell{0, 0, k};
      for (cell[1] = r.cells.lower[1]; cell[1] <= r.cells.upper[1]; ++cell[1])
        for (cell[0] = r.cells.lower[0]; cell[0] <= r.cells.upper[0]; ++cell[0])
          f(r, cell, cell[0] + std::ptrdiff_t(cell[1]) * pitch[1] + std::ptrdiff_t(k) * pitch[2],
            zero ? 0
                 : fluxes[std::ptrdiff_t(cell[u] - r.cells.lower[u]) * r.fluxes.pu +
                          std::ptrdiff_t(cell[v] - r.cells.lower[v]) * r.fluxes.pv]);
    }
  }

  std::size_t bytes() const;

 private:
  CompositeMesh& mesh_;
  std::vector<std::vector<Real>> of_level_;
};

}  // namespace amrpic
