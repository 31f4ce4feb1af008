#pragma once

#include <memory>
#include <vector>

#include "fem/interpolation.hpp"
#include "fem/operators.hpp"
#include "solver/chebyshev.hpp"
#include "solver/point_equations.hpp"

namespace amrpic {

/// The rows of an operator of degree 1, found by products with vectors that pick every third node along each axis.
/// Fixed unknowns have ones on the diagonal and no part in others' rows. Collective.
SharedRows corner_rows(fem::Operator const& a, std::vector<char> const& fixed);

/// A symmetric preconditioner for an operator at points: a V-cycle from its degree to degree 1 at the same points,
/// which is the Galerkin product, and from there on by MueLu's smoothed aggregates. Chebyshev's iteration smooths.
class NodeMultigrid {
 public:
  /// `inverse`: of the diagonal, zero where unknowns are fixed. Collective.
  NodeMultigrid(fem::Operator const& a, std::vector<Real> const& inverse);
  ~NodeMultigrid();

  /// z near the solution of A z = r, zero where unknowns are fixed, as r must be. Collective.
  void apply(std::vector<Real> const& r, std::vector<Real>& z);

 private:
  class Corners;  ///< level of degree 1
  fem::Operator const& fine_;
  std::vector<Real> inverse_;
  std::shared_ptr<fem::Lattice const> corners_;
  std::unique_ptr<fem::Interpolation> between_;  ///< null for degree 1
  std::unique_ptr<Chebyshev> smoother_;
  std::unique_ptr<Corners> coarse_;
  std::vector<Real> residual_, coarse_r_, coarse_z_;
};

}  // namespace amrpic
