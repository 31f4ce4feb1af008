// The layer of ghost centres behind a wall: at which of them the potential is computed, and the rest by interpolation.
#pragma once

#include <array>
#include <map>
#include <vector>

#include "freespace/octree.hpp"

namespace amrpic::freespace {

/// Axes of the plane, in ascending order.
constexpr std::array<int, 2> plane_axes(int normal) { return {normal == 0 ? 1 : 0, normal == 2 ? 1 : 2}; }

/// Nested grids of a plane. Grid g has nodes at cells first + stride * n, n < size, along each axis; the last one has
/// all cells.
struct PlaneGrids {
  struct Grid {
    std::array<int, 2> stride, size;
    int squares(int axis) const { return stride[axis] > 1 ? size[axis] - 1 : size[axis]; }
  };
  PlaneGrids(Lattice const& lattice, int face);

  int face, normal;
  int ghost;                              ///< index of the ghost cells along the normal
  std::array<int, 2> axes, cells, first;  ///< of the plane; cells: of the wall
  double place;                           ///< of the plane along its normal, smallest spacing = 1
  double depth;                           ///< spacing along the normal
  std::array<double, 2> spacing;          ///< along the axes, smallest = 1
  std::vector<Grid> grids;                ///< coarse to fine

  Cell cell(std::array<int, 2> const& in_plane) const;
};

/// Ghost values of one wall, grid after grid.
///
/// A square of a grid is halved where its middle, or a probe above the greatest charge of a box nearby, shows an error
/// of the six-point interpolation; new nodes elsewhere are interpolated. Squares that all charge is far from need no
/// probe. So that no narrow peak hides between probes, each box of charge that may raise one gets its own.
class PlaneFill {
 public:
  /// `tolerance`: of the interpolation, as a potential times 4 pi, lengths in units of the smallest spacing.
  PlaneFill(Lattice const& lattice, int face, std::vector<Leaf> const& leaves, Octree const& tree, double tolerance);

  /// Cells to compute next; none when done.
  std::vector<Cell> const& wanted() const { return wanted_; }
  /// Take the potential, in units of the tolerance, at the cells that were wanted.
  void give(double const* values);

  int face() const { return plane_.face; }
  /// Values at all ghost centres, lower axis fastest.
  std::vector<double> values() const;

 private:
  using Place = std::array<int, 2>;
  struct Probe {
    Place square, cell;
    bool is_middle;  ///< a new node of the next grid
  };
  PlaneGrids::Grid const& grid() const { return plane_.grids[grid_]; }
  bool is_last() const { return grid_ + 1 == int(plane_.grids.size()); }
  void want_probes(std::vector<Place> const& candidates);
  void refine(std::map<Place, double> const& squares);

  PlaneGrids plane_;
  std::vector<Leaf> const& leaves_;
  Octree const& tree_;
  double tolerance_;
  int grid_ = 0;
  std::vector<double> values_;  ///< on the present grid
  std::vector<Place> nodes_;    ///< of the present grid: the first of the wanted
  std::vector<Probe> probes_;   ///< the rest of the wanted
  std::vector<Cell> wanted_;
};

/// An estimate from below, 4 pi times the greatest potential, lengths in units of the smallest spacing.
double greatest_potential(Octree const& tree, Point const& shape);

}  // namespace amrpic::freespace
