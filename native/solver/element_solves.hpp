#pragma once

#include <vector>

#include "fem/operators.hpp"

namespace amrpic {

/// Elements with points most of which are much softer than the stiffest one. Local.
std::vector<fem::Points::Filled> uneven_elements(fem::Operator const& a);

/// What smooths the nodes of uneven elements, where the diagonal does not: additive solves, element by element.
///
/// A few stiff points leave an element motions of its nodes that hardly strain them. These cost little energy, but the
/// diagonal, most of which comes from those points, takes them for stiff, and degree 1 does not have them. So the
/// element's own matrix is solved with. Its diagonal is replaced by that of the whole operator, which stands for the
/// neighbours: no matrix goes to another rank. Nodes of several such elements take a part of each one's solution. An
/// element whose matrix is not positive, as where a solid is unstable, is left to the diagonal.
class ElementSolves {
 public:
  /// `inverse`: of the operator's diagonal, zero where unknowns are fixed. Collective.
  ElementSolves(fem::Operator const& a, std::vector<Real> const& inverse);

  /// Over all ranks.
  GlobalIndex elements() const { return count_; }

  /// z = S r, symmetric and positive definite, zero where unknowns are fixed; other nodes than those of such elements
  /// by the diagonal. Collective.
  void apply(std::vector<Real> const& r, std::vector<Real>& z);

 private:
  void share(std::vector<Real> const& inverse);
  void factor(fem::Operator const& a, std::vector<fem::Points::Filled> const& uneven, std::vector<Real> const& inverse);

  fem::Lattice const& lattice_;
  int components_;
  GlobalIndex count_;
  std::vector<fem::Points::Filled> numbered_;  ///< of each part; its first one begins a new group of lanes
  std::vector<Real> inverse_;                  ///< of the diagonal, zero at nodes of these elements
  std::vector<Real> share_;                    ///< of those, the root of what each element gets; zero at others
  std::vector<Real> shared_;
  std::vector<float, fem::BlockAllocator<float>> factors_;  ///< of each group L, column by column, L L' the matrix
};

}  // namespace amrpic
