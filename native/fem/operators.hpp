#pragma once

#include <functional>
#include <memory>
#include <vector>

#include "fem/points.hpp"

namespace amrpic::fem {

/// Entries of a matrix by global numbers of unknowns; those of one place are to be added.
struct Entries {
  std::vector<GlobalIndex> row, column;
  std::vector<Real> value;
};

/// A symmetric operator on vectors of nodes, whose integrals are sums over points.
class Operator {
 public:
  Operator(std::shared_ptr<Points const> points, int components)
      : points_(std::move(points)), components_(components) {}
  Operator(Operator const&) = delete;
  virtual ~Operator() = default;

  Points const& points() const { return *points_; }
  int components() const { return components_; }
  std::size_t unknowns() const { return std::size_t(points_->lattice().own_nodes()) * std::size_t(components_); }

  /// v = A u. Collective.
  virtual void apply(Real const* u, Real* v) const = 0;
  /// The same nearly, where that takes less time, for smoothers: in single precision at points. Collective.
  virtual void apply_nearly(Real const* u, Real* v) const { apply(u, v); }
  /// Collective.
  virtual std::vector<Real> diagonal() const = 0;
  /// The same operator for another degree; `points` are its own on that lattice.
  virtual std::unique_ptr<Operator> on(std::shared_ptr<Points const> points) const = 0;
  /// Whether rotations cost nothing, nearly, as in a solid without stress.
  virtual bool has_rigid_modes() const { return false; }

  /// How stiff each of this rank's points is: the trace of what makes fluxes of slopes there, with its weight. Local.
  virtual std::vector<Real> stiffness_of_points() const = 0;

  /// Call f(part of the lattice, first node among the part's, matrix) for each of this rank's elements with points, or
  /// for some of these. Rows and columns of an element are its nodes, x fastest, component after component. Local.
  using TakeMatrix = std::function<void(std::size_t part, LocalIndex corner, std::vector<Real> const& matrix)>;
  virtual void for_each_matrix_of(std::vector<Points::Filled> const& elements, TakeMatrix const& f) const = 0;
  void for_each_element_matrix(TakeMatrix const& f) const { for_each_matrix_of(points_->filled(), f); }

  /// What this rank's elements add to the matrix. An unknown's number is that of its node times the components, plus
  /// its own. Local.
  Entries entries() const;

 private:
  std::shared_ptr<Points const> points_;
  int components_;
};

/// (u, v), and (grad u, grad v), each component by itself: 1 or 3.
std::unique_ptr<Operator> mass(std::shared_ptr<Points const> points, int components);
std::unique_ptr<Operator> poisson(std::shared_ptr<Points const> points, int components);

// ---- between nodes and points ----
// Arrays of points hold the components of each side by side; slopes (components, 3) are those in space.

/// Values of a vector of nodes at points, or its slopes. Collective.
std::vector<Real> values_at(Points const& points, int components, Real const* u);
std::vector<Real> slopes_at(Points const& points, int components, Real const* u);

/// Sums over points of weight, value and each node's function. Collective.
std::vector<Real> integrals(Points const& points, int components, Real const* values);

}  // namespace amrpic::fem
