#pragma once

#include <vector>

#include "mesh/metal.hpp"
#include "stencil/equation.hpp"
#include "stencil/odd_extents.hpp"

namespace amrpic::cycle {

/// Solves a 7-point equation on a whole cuboid exactly.
class Direct {
 public:
  virtual ~Direct() = default;
  /// Replace the right-hand side (x fastest) by the solution.
  virtual void solve(std::vector<Real>& values) = 0;
};

/// Its operator is a sum of operators along one axis each, and in
/// the product of their eigenvectors it is diagonal (Lynch, Rice and Thomas, Numer. Math. 6, 185, 1964).
class FastDiagonalisation : public Direct {
 public:
  /// With ghosts behind walls, and with finite volumes where the last cell of a periodic axis has a width of its own.
  /// `leaves_mean`: constants solve the homogeneous equation, or little holds them.
  FastDiagonalisation(Index3 const& cells, Equation const& equation, WallGhosts const& walls,
                      std::array<bool, 3> const& periodic, Real3 const& seam_width, bool leaves_mean);

  /// The solution without a constant, if it leaves the mean.
  void solve(std::vector<Real>& values) override;

 private:
  struct Axis {
    std::vector<Real> eigenvalue;
    std::vector<Real> to, from;  ///< into the eigenvectors' coordinates and back, row by row
  };
  static Axis axis(int n, Real weight, std::array<WallGhost, 2> const& walls, bool periodic, Real seam_width);
  void transform(int axis, std::vector<Real> const& matrix, std::vector<Real>& values);

  Index3 cells_;
  Real shift_;
  bool leaves_mean_;
  std::array<Axis, 3> axes_;
  std::vector<Real> scratch_;
};

/// With cells in metal, or beside it: the whole matrix, factored. For few cells.
class DenseRows : public Direct {
 public:
  DenseRows(Index3 const& cells, Equation const& equation, WallGhosts const& walls, std::array<bool, 3> const& periodic,
            Real3 const& seam_width, MetalCells const& metal);
  void solve(std::vector<Real>& values) override;

 private:
  std::vector<Real> matrix_;  ///< column by column, then its factors
  std::vector<int> pivots_;
  std::vector<std::size_t> solid_;
};

}  // namespace amrpic::cycle
