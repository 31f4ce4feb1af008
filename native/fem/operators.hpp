#pragma once

#include <memory>
#include <vector>

#include "fem/points.hpp"

namespace amrpic::fem {

enum class Term { mass, poisson };

/// Entries of a matrix by global numbers of unknowns; those of one place are to be added.
struct Entries {
  std::vector<GlobalIndex> row, column;
  std::vector<Real> value;
};

/// Mass (u, v) or Poisson's operator (grad u, grad v), each component by itself, summed over points.
class Operator {
 public:
  /// `components`: 1 or 3.
  Operator(std::shared_ptr<Points const> points, Term term, int components)
      : points_(std::move(points)), term_(term), components_(components) {}

  Points const& points() const { return *points_; }
  Term term() const { return term_; }
  int components() const { return components_; }
  std::size_t unknowns() const { return std::size_t(points_->lattice().own_nodes()) * std::size_t(components_); }

  /// v = A u. Collective.
  void apply(Real const* u, Real* v) const;
  /// Collective.
  std::vector<Real> diagonal() const;
  /// What this rank's elements add to the matrix. An unknown's number is that of its node times the components, plus
  /// its own. Local.
  Entries entries() const;

 private:
  std::shared_ptr<Points const> points_;
  Term term_;
  int components_;
};

// ---- between nodes and points ----
// Arrays of points hold the components of each side by side; slopes (components, 3) are those in space.

/// Values of a vector of nodes at points, or its slopes. Collective.
std::vector<Real> values_at(Points const& points, int components, Real const* u);
std::vector<Real> slopes_at(Points const& points, int components, Real const* u);

/// Sums over points of weight, value and each node's function. Collective.
std::vector<Real> integrals(Points const& points, int components, Real const* values);

}  // namespace amrpic::fem
