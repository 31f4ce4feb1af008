#pragma once

#include <memory>
#include <vector>

#include "fem/lattice.hpp"

namespace amrpic::fem {

/// Between nodes of any degree and the corners of the same elements, which are the nodes of degree 1.
class Interpolation {
 public:
  Interpolation(std::shared_ptr<Lattice const> fine, std::shared_ptr<Lattice const> corners);

  /// Add what is linear in each element between corners to a vector of the finer nodes. Collective.
  void add(int components, Real const* corners, Real* fine) const;
  /// The transpose: corners take from finer nodes. Collective.
  void transposed(int components, Real const* fine, Real* corners) const;
  /// What a vector of the finer nodes has at own corners. Local.
  std::vector<Real> at_corners(int components, Real const* fine) const;

 private:
  /// Call f(own node, place of a corner in the part's dense array, weight) for all of a part's own nodes.
  template <class F>
  void for_each_weight(std::size_t part, F&& f) const;

  std::shared_ptr<Lattice const> fine_, corners_;
  std::vector<Real> share_;  ///< of an element's upper corner, for its nodes along an axis but the last
};

}  // namespace amrpic::fem
