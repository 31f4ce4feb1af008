// Matrices of elements from a function of slopes at points, which is linear: what it makes of unit slopes, between the
// gradients of nodes' functions.
#pragma once

#include "fem/at_points.hpp"

namespace amrpic::fem {

/// The matrix of one element after another for a function D of slopes, as in `AtPoints`, whichever it is.
///
/// Between components a and b it is Gᵀ H: G has a row for each point and axis with the slopes of all nodes' functions,
/// and H what D makes of these slopes of b along that axis of a. The product keeps a block of sums in registers.
template <int P, int C>
class ElementMatrix {
  static constexpr int nodes = P * P * P;
  static constexpr int fewest = (nodes + native_lane_count - 1) / native_lane_count;
  static constexpr int vectors = fewest <= 4 ? fewest : (fewest + 3) / 4 * 4;  ///< of the slopes of nodes, with zeros
  static constexpr int padded = vectors * native_lane_count;
  static constexpr int rows_at_once = P == 3 || P == 5 ? P : 4;
  static constexpr int vectors_at_once = vectors < 4 ? vectors : 4;
  static_assert(nodes % rows_at_once == 0 && vectors % vectors_at_once == 0);

 public:
  ElementMatrix(Points const& points, PointFunction<C> const& d) : points_(points), d_(d) {}

  /// Rows and columns are nodes, x fastest, component after component.
  void fill(LocalIndex element, std::vector<Real>& matrix);

 private:
  /// Slopes of nodes' functions at the points of a block, and what D makes of unit slopes there.
  void read(std::int64_t block, std::size_t number);
  Rows<P, V> of_nodes(V const& x) const;
  /// H for components a and b.
  void make(std::size_t blocks, int a, int b);
  /// Some rows and columns of GᵀH, to their place in the matrix and to that of the transpose.
  void multiply(std::size_t rows, int a, int b, int first, int vector, Real* matrix) const;

  Points const& points_;
  PointFunction<C> d_;
  Matrix<P> const of_node_ = transposed(nodes_to_chebyshev<P>());
  BlockValues slopes_, made_;
  std::vector<V, BlockAllocator<V>> of_units_;  ///< of each block: component and axis of the slope, then of its flux
};

}  // namespace amrpic::fem
