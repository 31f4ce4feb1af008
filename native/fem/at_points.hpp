// Operators at points anywhere in their elements: Chebyshev coefficients of an element, then point after point, its
// values and slopes, a function of these, and its share of the sums over points; nothing is stored in between.
#pragma once

#include "fem/contraction.hpp"
#include "fem/elements.hpp"

namespace amrpic::fem {

/// C components at the points of a block, or what they are tested with there.
template <int C>
struct AtPoint {
  V value[C];
  Vector3<V> slope[C];  ///< in coordinates of the element, -1 to 1
};

/// Rows by Chebyshev's polynomials: what nodes have becomes coefficients, and sums become those of nodes.
template <int P>
struct ChebyshevRows {
  static constexpr Basis basis = Basis::chebyshev;
  Matrix<P> from_nodes = nodes_to_chebyshev<P>(), to_nodes = transposed(nodes_to_chebyshev<P>());

  Rows<P, V> operator()(V const& x) const { return chebyshev_rows<P>(x); }
};

/// Rows by squares of the nodes' own functions and of their slopes: products of them are those on an operator's
/// diagonal.
template <int P>
struct SquaredRows {
  static constexpr Basis basis = Basis::any;
  Matrix<P> of_node = transposed(nodes_to_chebyshev<P>());

  Rows<P, V> operator()(V const& x) const {
    auto const chebyshev = chebyshev_rows<P>(x);
    Rows<P, V> out;
    for (int i = 0; i < P; ++i) {
      V value{}, slope{};
      for (int n = 0; n < P; ++n) {
        value += of_node[i][n] * chebyshev.value[n];
        slope += of_node[i][n] * chebyshev.slope[n];
      }
      out.value[i] = value * value, out.slope[i] = slope * slope;
    }
    return out;
  }
};

/// D is the function at points: d(block, at) turns what is there into what it is tested with. It says which of both it
/// `reads` and `writes`, and whether these are `values` or `slopes`.
template <int P, int C, class D, class BasisRows = ChebyshevRows<P>>
struct AtPoints {
  static constexpr bool reads = D::reads, writes = D::writes;
  static constexpr int nodes = P * P * P, whole = (nodes + native_lane_count - 1) / native_lane_count;

  Points const& points;
  D d;
  BasisRows rows = {};

  void operator()(LocalIndex const* elements, int count, GroupValues<P, C>& values) const {
    if constexpr (reads)
      for (int c = 0; c < C; ++c) transform(rows.from_nodes, values.value[c]);
    for (int lane = 0; lane < count; ++lane) element(elements[lane], lane, values);
    if constexpr (writes && BasisRows::basis == Basis::chebyshev)
      for (int c = 0; c < C; ++c) transform(rows.to_nodes, values.value[c]);
  }

 private:
  /// One element, whose coefficients are in a lane, and whose sums go there.
  void element(LocalIndex element, int lane, GroupValues<P, C>& values) const {
    Real coefficients[C][nodes];  // side by side: those of all lanes take more than a first-level cache has
    if constexpr (reads)
      for (int c = 0; c < C; ++c)
        for (int n = 0; n < nodes; ++n) coefficients[c][n] = values.value[c][n][lane];
    V sums[C][whole * native_lane_count];
    if constexpr (writes)
      for (int c = 0; c < C; ++c)
        for (V& sum : sums[c]) sum = V{};
    for (std::int64_t block = points.first_block(element); block < points.first_block(element + 1); ++block) {
      Real const* const place = points.places() + 3 * native_lane_count * block;
      Vector3<Rows<P, V>> const here{rows(load<V>(place)), rows(load<V>(place + native_lane_count)),
                                     rows(load<V>(place + 2 * native_lane_count))};
      AtPoint<C> at;
      if constexpr (reads)
        for (int c = 0; c < C; ++c) {
          if constexpr (D::values) at.value[c] = value_at<BasisRows::basis>(coefficients[c], here);
          if constexpr (D::slopes) at.slope[c] = gradient_at<BasisRows::basis>(coefficients[c], here);
        }
      d(block, at);
      if constexpr (writes)
        for (int c = 0; c < C; ++c) {
          if constexpr (D::values) add_by_value<BasisRows::basis>(at.value[c], here, sums[c]);
          if constexpr (D::slopes) add_by_gradient<BasisRows::basis>(at.slope[c], here, sums[c]);
        }
    }
    if constexpr (writes)
      for (int c = 0; c < C; ++c) write(sums[c], lane, values.value[c]);
  }

  static void write(V const* sums, int lane, V* values) {
    for (int first = 0; first < nodes; first += native_lane_count) {
      V const of_lanes = sums_of_lanes(sums + first);
      for (int n = 0; n < native_lane_count; ++n)
        if (first + n < nodes) values[first + n][lane] = of_lanes[n];
    }
  }
};

}  // namespace amrpic::fem
