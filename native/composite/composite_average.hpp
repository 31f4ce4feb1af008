#pragma once

#include "composite/composite_mesh.hpp"
#include "mesh/norm.hpp"

namespace amrpic {

/// Means of children in covered cells, and corrections of the others.
class CompositeAverage {
 public:
  explicit CompositeAverage(CompositeMesh& mesh) : mesh_(mesh), covered_(mesh.largest_face(2)) {}

  /// See CompositeLaplacian. Collective.
  void average_down(Field& phi) { mesh_.transfer().average_down({&phi}); }
  template <class T>
  Real add(Blocks<T> const& correction, Real scale, Field& phi);

  std::size_t bytes() const { return covered_.capacity() * sizeof(Real); }

 private:
  template <class Set>
  void set_uncovered(int l, int b, int k, Real* plane, Set&& set);
  template <class T>
  void add_plane(int l, int b, int k, Block<T> const& correction, Real scale, Real* phi, Largest<T>& largest);

  CompositeMesh& mesh_;
  std::vector<Real> covered_;  ///< what the covered cells of a plane hold
};

}  // namespace amrpic
