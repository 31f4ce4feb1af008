#pragma once

#include <algorithm>
#include <vector>

#include "composite/composite_mesh.hpp"
#include "stencil/interface.hpp"

namespace amrpic {

/// A side of a box with coarser cells behind it: steps from cell to cell along it and inwards, and to the next row of
/// ghosts.
struct FineSide {
  std::int32_t cell_u, cell_v, inward, ghost_v;

  /// Set the four ghosts before a coarse face, by phi* there; returns what they leave for the cell behind it: the sum
  /// of phi_1 - ghost, from which its outward derivative is a quarter of that over the fine spacing. `cell`, `ghost`:
  /// the first of the four.
  KOKKOS_INLINE_FUNCTION Real set_ghosts(FourStars<Real> const& stars, Real const* cell, Real* ghost) const {
    Real sum = 0;
    for (std::size_t b = 0; b < 2; ++b, cell += cell_v, ghost += ghost_v) {
      Real const* const next = cell + cell_u;
      Real const lower = ghost_at_interface(stars[b][0], cell[0], cell[inward]);
      Real const upper = ghost_at_interface(stars[b][1], next[0], next[inward]);
      ghost[0] = lower, ghost[1] = upper;
      sum += (cell[0] - lower) + (next[0] - upper);
    }
    return sum;
  }
};

inline FineSide fine_side(Box const& box, int axis, int side) {
  auto const [u, v] = tangential_axes(axis);
  Index3 const pitch = box.strides();
  return {pitch[u], pitch[v], side == 0 ? pitch[axis] : -pitch[axis], box.extent(u)};
}

/// The four ghosts before a coarse face beside metal, see MetalFace: what they have of phi*, of the cell before them
/// and of the next one. Those that are not linked are not read.
struct GhostsBesideMetal {
  GhostsBesideMetal() = default;
  explicit GhostsBesideMetal(MetalFace const& face)
      : linked(face.linked), of_links(face.links > 0 ? face.of_links() : 0) {
    for (std::size_t b = 0; b < 2; ++b)
      for (std::size_t a = 0; a < 2; ++a)
        star[b][a] = face.star(a, b), first[b][a] = face.first(a, b), second[b][a] = face.second(a, b);
  }

  /// As FineSide has it.
  KOKKOS_INLINE_FUNCTION Real set(FineSide const& side, FourStars<Real> const& stars, Real const* cell,
                                  Real* ghost) const {
    Real sum = 0;
    for (std::size_t b = 0; b < 2; ++b, cell += side.cell_v, ghost += side.ghost_v)
      for (std::size_t a = 0; a < 2; ++a) {
        if (!linked[b][a]) continue;
        Real const* const at = cell + std::int32_t(a) * side.cell_u;
        Real const value = star[b][a] * stars[b][a] + first[b][a] * at[0] + second[b][a] * at[side.inward];
        ghost[a] = value;
        sum += at[0] - value;
      }
    return of_links * sum;
  }

  FourStars<Real> star{}, first{}, second{};
  FourStars<char> linked{};
  Real of_links = 0;
};

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
  /// that beside a cell at side.flux_at(cell).
  template <class F>
  void for_each_refined_side(int l, int b, F&& f) const {
    for (int s = mesh_.plan(l, b).refined.first; s < mesh_.plan(l, b).refined.last; ++s) {
      RefinedSide const& r = mesh_.plan(l).refined[std::size_t(s)];
      f(r, of(l, r));
    }
  }
  /// Those among which the ones through a side of a box of a level are.
  Real const* of(int l, RefinedSide const& r) const {
    return r.fluxes.here ? of_level_[std::size_t(l) + 1].data() : mesh_.plan(l).finer_fluxes.values();
  }
  /// Call f(side, first cell, count, fluxes, how far apart these are) for the rows of cells on such sides, side by
  /// side, in planes `first` to `last` of a box.
  template <class F>
  void for_each_refined_row(int l, int b, int first, int last, F&& f) const {
    for_each_refined_side(l, b, [&](RefinedSide const& r, Real const* fluxes) {
      Index3 cell = r.cells.lower;
      for (cell[2] = std::max(first, r.cells.lower[2]); cell[2] <= std::min(last, r.cells.upper[2]); ++cell[2])
        for (cell[1] = r.cells.lower[1]; cell[1] <= r.cells.upper[1]; ++cell[1])
          f(r, cell, r.cells.extent(0), fluxes + r.flux_at(cell),
            std::ptrdiff_t(r.fluxes.pu));  // along x, where a row has more than one
    });
  }

  std::size_t bytes() const;

 private:
  CompositeMesh& mesh_;
  std::vector<std::vector<Real>> of_level_;
};

}  // namespace amrpic
