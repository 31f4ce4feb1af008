#pragma once

#include <functional>
#include <optional>

#include "composite/coarse_fluxes.hpp"
#include "mesh/gap_values.hpp"
#include "mesh/walls.hpp"
#include "stencil/interface.hpp"

namespace amrpic {

/// The ghost cells around one box after the other, and the fluxes that finer levels leave for coarser ones, so that
/// each face has one flux.
class CompositeGhosts {
 public:
  explicit CompositeGhosts(CompositeMesh& mesh);

  /// Call f(level, box) for all boxes of this rank, finest level first, with the ghosts of the box at hand and the
  /// fluxes from the finer level through its faces; and done(level) after all of a level. Collective.
  /// `potentials`: of electrodes.
  void visit(Field const& phi, std::vector<Walls> const& walls, std::vector<Real> const& potentials,
             FullyCovered fully_covered, std::function<void(int, int)> const& f,
             std::function<void(int)> const& done = nullptr);

  /// Those of the box under way beyond a face, the lower tangential axis fastest.
  Real const* ghosts(int axis, int side) const { return ghosts_[std::size_t(2 * axis + side)].data(); }

  /// Call f(place in the box, axis, side, excess) for each uncovered cell of a plane and each of its faces with a
  /// refined cell beyond: the difference of phi across the face by the finer fluxes, less that to the covered
  /// neighbour.
  template <class F>
  void for_each_refined(int l, int b, int k, Real const* phi, F&& f) const {
    Box const& own = mesh_.box(l, b);
    Index3 const pitch = own.strides();
    fluxes_.for_each_refined_side(l, b, [&](RefinedSide const& r, Real const* fluxes) {
      if (k < r.cells.lower[2] || k > r.cells.upper[2]) return;
      auto const [u, v] = tangential_axes(r.axis);
      int const layer = r.cells.lower[r.axis];
      bool const inside = r.side == 0 ? layer > 0 : layer + 1 < own.extent(r.axis);
      std::ptrdiff_t const outward = r.side == 0 ? -pitch[r.axis] : pitch[r.axis];
      Real const* const beyond = ghosts(r.axis, r.side);
      Index3 cell{0, 0, k};
      for (cell[1] = r.cells.lower[1]; cell[1] <= r.cells.upper[1]; ++cell[1])
        for (cell[0] = r.cells.lower[0]; cell[0] <= r.cells.upper[0]; ++cell[0]) {
          std::ptrdiff_t const at = cell[0] + std::ptrdiff_t(cell[1]) * pitch[1] + std::ptrdiff_t(k) * pitch[2];
          Real const covered = inside ? phi[at + outward] : beyond[cell[u] + std::ptrdiff_t(cell[v]) * own.extent(u)];
          f(at, r.axis, r.side, fine_face_weight * fluxes[r.flux_at(cell)] - (covered - phi[at]));
        }
    });
  }

  // Of a cell of the box under way, whose value is at `phi`: what lies beyond a side, before finer cells the value that
  // gives their flux; the difference that this makes; the datum of a wall there; and the values along an axis.
  Real value_beyond(int l, int b, CompositeMesh::CutHere const& here, int side, Real const* phi) const {
    std::ptrdiff_t const step = mesh_.box(l, b).stride(side / 2);
    return here.is_inside(std::size_t(side)) ? phi[side % 2 == 0 ? -step : step]
                                             : value_outside(l, b, here.at, side, *phi);
  }
  std::optional<Real> difference_beyond(int l, int b, Index3 const& cell, int side) const;
  Real wall_datum(int l, int b, Index3 const& cell, int side, std::vector<Walls> const& walls) const;
  ArmValues line_through(int l, int b, CompositeMesh::CutHere const& here, int axis, Real const* phi,
                         std::vector<Walls> const& walls, std::vector<Real> const& potentials) const;

  std::size_t bytes() const;

 private:
  Real value_outside(int l, int b, Index3 const& cell, int side, Real phi) const;
  void fill(int l, int b, Field const& phi, Walls const& walls, std::vector<Real> const& potentials);
  void fill_wall(int l, int b, int axis, int side, Real const* phi, Real const* data);
  void fill_interface(int l, int b, int axis, int side, Field const& phi);
  void fill_beside_metal(int l, int b, int axis, int side, Field const& phi, std::vector<Real> const& potentials);
  GapFit const* const* fit_in_gaps(GapFit const* const* in_gap, FitNumber const* fits, int count, int u, Index3 cell,
                                   Real* lower_row, Real* upper_row) const;
  void fill_gaps(int l, Gaps const& gaps, Field const& phi);

  CompositeMesh& mesh_;
  CoarseFluxes fluxes_;
  std::array<std::vector<Real>, 6> ghosts_;         ///< of the box under way, by face, u fastest
  std::vector<Real> coarse_, star_;                 ///< of the interface under way: coarse values, two rows of phi*
  GapValues<Real> coarse_gap_values_, gap_values_;  ///< of the gaps under way
};

}  // namespace amrpic
