#pragma once

#include <memory>
#include <vector>

#include "fem/interpolation.hpp"
#include "fem/operators.hpp"
#include "solver/element_solves.hpp"
#include "solver/node_aggregates.hpp"
#include "solver/node_levels.hpp"

namespace amrpic {

enum class CornerCycle { halving, aggregation };

/// A symmetric preconditioner for an operator at points: a V-cycle from its degree to degree 1 at the same points,
/// which is the Galerkin product, and from there on by half the elements or by MueLu's smoothed aggregates. Chebyshev's
/// iteration smooths, with the diagonal and, at nodes of uneven elements, solves of these.
class NodeMultigrid {
 public:
  /// `inverse`: of the diagonal, zero where unknowns are fixed. `solves_elements`: whether uneven ones are solved for.
  /// Collective.
  NodeMultigrid(fem::Operator const& a, std::vector<Real> inverse, CornerCycle kind, bool solves_elements);

  /// Smooth for another operator near the one that it was made of, on the same nodes with the same ones fixed; coarser
  /// levels stay. `inverse`: of its diagonal.
  void smooth_for(fem::Operator const& a, std::vector<Real> inverse);

  /// z near the solution of A z = r, zero where unknowns are fixed, as r must be. Collective.
  void apply(std::vector<Real> const& r, std::vector<Real>& z);

 private:
  void make_smoother(fem::Operator const& a, std::vector<Real> inverse, bool solves_elements);
  void solve_corners(std::vector<Real> const& r, std::vector<Real>& z);

  fem::Operator const* fine_;
  std::vector<bool> fixed_;  ///< of each unknown
  std::vector<Real> corners_free_;
  std::unique_ptr<fem::Interpolation> between_;  ///< null for degree 1
  std::unique_ptr<ElementSolves> elements_;      ///< null for degree 1, and where no element is uneven
  std::unique_ptr<Chebyshev> smoother_;
  std::unique_ptr<NodeLevels> levels_;  ///< one of both
  std::unique_ptr<NodeAggregates> aggregates_;
  std::vector<Real> coarse_r_, coarse_z_;
};

}  // namespace amrpic
