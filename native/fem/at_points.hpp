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

/// f of each coordinate of a block's points.
template <class F>
inline auto rows_at_block(Points const& points, std::int64_t block, F const& f) {
  Real const* const place = points.places() + 3 * native_lane_count * block;
  return Vector3<decltype(f(V{}))>{f(load<V>(place)), f(load<V>(place + native_lane_count)),
                                   f(load<V>(place + 2 * native_lane_count))};
}

/// Vectors that hold P^3 sums, whole ones for `sums_of_lanes`.
template <int P>
constexpr int whole_sums = (P * P * P + native_lane_count - 1) / native_lane_count* native_lane_count;

/// Sums over the lanes of each, into one lane of values.
template <int P>
inline void write_sums(V const* sums, int lane, V* values) {
  constexpr int nodes = P * P * P;
  for (int first = 0; first < nodes; first += native_lane_count) {
    V const of_lanes = sums_of_lanes(sums + first);
    for (int n = 0; n < native_lane_count; ++n)
      if (first + n < nodes) values[first + n][lane] = of_lanes[n];
  }
}

/// D is the function at points: d(block, at) turns what is there into what it is tested with. It says which of both it
/// `reads` and `writes`, and whether these are `values` or `slopes`.
template <int P, int C, class D>
struct AtPoints {
  static constexpr bool reads = D::reads, writes = D::writes;
  static constexpr int nodes = P * P * P;

  Points const& points;
  D d;
  Matrix<P> from_nodes = nodes_to_chebyshev<P>(), to_nodes = transposed(nodes_to_chebyshev<P>());

  void operator()(LocalIndex const* elements, int count, GroupValues<P, C>& values) const {
    if constexpr (reads)
      for (int c = 0; c < C; ++c) transform(from_nodes, values.value[c]);
    for (int lane = 0; lane < count; ++lane) element(elements[lane], lane, values);
    if constexpr (writes)
      for (int c = 0; c < C; ++c) transform(to_nodes, values.value[c]);
  }

 private:
  /// One element, whose coefficients are in a lane, and whose sums go there. All that it calls is inlined: left alone,
  /// the compiler passed the matrices of solids from call to call through memory, which took as long as all else.
  __attribute__((flatten)) void element(LocalIndex element, int lane, GroupValues<P, C>& values) const {
    Real coefficients[C][nodes];  // side by side: those of all lanes take more than a first-level cache has
    if constexpr (reads)
      for (int c = 0; c < C; ++c)
        for (int n = 0; n < nodes; ++n) coefficients[c][n] = values.value[c][n][lane];
    V sums[C][whole_sums<P>];
    if constexpr (writes)
      for (int c = 0; c < C; ++c)
        for (V& sum : sums[c]) sum = V{};
    for (std::int64_t block = points.first_block(element); block < points.first_block(element + 1); ++block) {
      auto const here = rows_at_block(points, block, chebyshev_rows<P, V>);
      AtPoint<C> at;
      if constexpr (reads)
        for (int c = 0; c < C; ++c) {
          if constexpr (D::values) at.value[c] = value_at<Basis::chebyshev>(coefficients[c], here);
          if constexpr (D::slopes) at.slope[c] = gradient_at<Basis::chebyshev>(coefficients[c], here);
        }
      d(block, at);
      if constexpr (writes)
        for (int c = 0; c < C; ++c) {
          if constexpr (D::values) add_by_value<Basis::chebyshev>(at.value[c], here, sums[c]);
          if constexpr (D::slopes) add_by_gradient<Basis::chebyshev>(at.slope[c], here, sums[c]);
        }
    }
    if constexpr (writes)
      for (int c = 0; c < C; ++c) write_sums<P>(sums[c], lane, values.value[c]);
  }
};

/// Factors of the square of a node's function at the points of a block, and of products of its slopes.
template <int C>
struct SquaresAtPoint {
  V value[C];
  std::array<Vector3<V>, 3> slope[C];
};

/// Sums over points of squares of nodes' functions and of products of their slopes: d(block, at) gives the factors.
template <int P, int C, class D>
struct DiagonalAtPoints {
  static constexpr bool reads = false, writes = true;

  Points const& points;
  D d;
  Matrix<P> of_node = transposed(nodes_to_chebyshev<P>());

  void operator()(LocalIndex const* elements, int count, GroupValues<P, C>& values) const {
    for (int lane = 0; lane < count; ++lane) {
      V sums[C][whole_sums<P>];
      for (int c = 0; c < C; ++c)
        for (V& sum : sums[c]) sum = V{};
      for (std::int64_t block = points.first_block(elements[lane]); block < points.first_block(elements[lane] + 1);
           ++block) {
        auto const rows = rows_at_block(points, block, [&](V const& x) { return pairs(x); });
        SquaresAtPoint<C> at{};
        d(block, at);
        for (int c = 0; c < C; ++c) add_squares<P>(at.value[c], at.slope[c], rows, sums[c]);
      }
      for (int c = 0; c < C; ++c) write_sums<P>(sums[c], lane, values.value[c]);
    }
  }

 private:
  PairedRows<P, V> pairs(V const& x) const {
    auto const chebyshev = chebyshev_rows<P>(x);
    PairedRows<P, V> out;
    for (int i = 0; i < P; ++i) {
      V value{}, slope{};
      for (int n = 0; n < P; ++n) {
        value += of_node[i][n] * chebyshev.value[n];
        slope += of_node[i][n] * chebyshev.slope[n];
      }
      out.values[i] = value * value, out.mixed[i] = value * slope, out.slopes[i] = slope * slope;
    }
    return out;
  }
};

}  // namespace amrpic::fem
