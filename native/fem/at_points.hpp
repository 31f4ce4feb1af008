// Operators at points anywhere in their elements: Chebyshev coefficients of an element, then point after point, its
// values and slopes, a function of these, and its share of the sums over points; nothing is stored in between.
#pragma once

#include <algorithm>
#include <limits>
#include <type_traits>

#include "fem/contraction.hpp"
#include "fem/elements.hpp"

namespace amrpic::fem {

/// C components at the points of a block, or what they are tested with there.
template <int C, class Vector = V>
struct AtPoint {
  Vector value[C];
  Vector3<Vector> slope[C];  ///< in coordinates of the element, -1 to 1
};

/// A function at points, see `AtPoints`, whichever it is: for what does so much else that a call costs nothing.
template <int C>
struct PointFunction {
  void const* d;
  void (*call)(void const*, std::int64_t, AtPoint<C>&);

  template <class D>
  static PointFunction of(D const& d) {
    return {&d, [](void const* own, std::int64_t block, AtPoint<C>& at) { (*static_cast<D const*>(own))(block, at); }};
  }
  void operator()(std::int64_t block, AtPoint<C>& at) const { call(d, block, at); }
};

/// One of slopes, that are read and perhaps written.
template <int C, bool to_write>
struct AnyOfSlopes : PointFunction<C> {
  static constexpr bool reads = true, writes = to_write, values = false, slopes = true;
};

/// f of each coordinate of a block's points.
template <class Block, class F>
inline auto rows_at_block(Points const& points, Block const& block, F const& f) {
  auto const of = [&](int axis) { return f(of_block(points.places(), block, 3, axis)); };
  return Vector3<decltype(of(0))>{of(0), of(1), of(2)};
}

/// Vectors that hold P^3 sums, whole ones for `sums_of_lanes`.
template <int P>
constexpr int whole_sums = (P * P * P + native_lane_count - 1) / native_lane_count* native_lane_count;

/// Sums over the lanes of each, into one lane of values.
template <int P, class Vector>
inline void write_sums(Vector const* sums, int lane, V* values) {
  constexpr int nodes = P * P * P;
  for (int first = 0; first < nodes; first += native_lane_count) {
    auto const of_lanes = sums_of_lanes(sums + first);
    for (int n = 0; n < native_lane_count; ++n)
      if (first + n < nodes) values[first + n][lane] = of_lanes[n];
  }
}

/// The same of pairs of blocks.
template <int P>
inline void write_sums(NativeFloats const* sums, int lane, V* values) {
  HalfFloats of_both[whole_sums<P>];
  for (int n = 0; n < whole_sums<P>; ++n) {
    auto const [low, high] = halves(sums[n]);
    of_both[n] = low + high;
  }
  write_sums<P, HalfFloats>(of_both, lane, values);
}

/// D is the function at points: d(block, at) turns what is there into what it is tested with. It says which of both it
/// `reads` and `writes`, and whether these are `values` or `slopes`. In `single` precision points are taken by pairs of
/// blocks, and D by such.
template <int P, int C, class D, bool single = false>
struct AtPoints {
  static constexpr bool reads = D::reads, writes = D::writes;
  static constexpr int nodes = P * P * P;

  Points const& points;
  D d;
  Matrix<P> from_nodes = nodes_to_chebyshev<P>(), to_nodes = transposed(nodes_to_chebyshev<P>());

  void operator()(LocalIndex const* elements, int count, GroupValues<P, C>& values) const;

 private:
  using Block = std::conditional_t<single, BlockPair, std::int64_t>;
  using Vector = VectorOf<Block>;
  using Number = NumberOf<Vector>;

  /// The largest coefficient of each element. In single precision others are parts of it: none is too small for that.
  static V largest(GroupValues<P, C> const& values) {
    V out = V{} + std::numeric_limits<Real>::min();
    for (auto const& component : values.value)
      for (V const& value : component) {
        V const size = value < 0 ? -value : value;
        out = size > out ? size : out;
      }
    return out;
  }
  static void multiply(V const& by, GroupValues<P, C>& values) {
    for (auto& component : values.value)
      for (V& value : component) value *= by;
  }

  /// One element, whose coefficients are in a lane, and whose sums go there. All that it calls is inlined: left alone,
  /// the compiler passed the matrices of solids from call to call through memory, which took as long as all else.
  __attribute__((flatten)) void element(LocalIndex element, int lane, GroupValues<P, C>& values) const {
    Number coefficients[C][nodes];  // side by side: those of all lanes take more than a first-level cache has
    if constexpr (reads)
      for (int c = 0; c < C; ++c)
        for (int n = 0; n < nodes; ++n) coefficients[c][n] = Number(values.value[c][n][lane]);
    Vector sums[C][whole_sums<P>];
    if constexpr (writes)
      for (int c = 0; c < C; ++c)
        for (Vector& sum : sums[c]) sum = Vector{};
    std::int64_t const last = points.first_block(element + 1);
    for (std::int64_t first = points.first_block(element); first < last; first += single ? 2 : 1) {
      Block const block = block_at(first, last);
      auto const here = rows_at_block(points, block, chebyshev_rows<P, Vector>);
      AtPoint<C, Vector> at;
      if constexpr (reads)
        for (int c = 0; c < C; ++c) {
          if constexpr (D::values) at.value[c] = value_at<Basis::chebyshev>(coefficients[c], here);
          if constexpr (D::slopes) at.slope[c] = gradient_at<Basis::chebyshev>(coefficients[c], here);
        }
      d(block, at);
      if constexpr (single)
        if (block.second == block.first) drop_second(at);
      if constexpr (writes)
        for (int c = 0; c < C; ++c) {
          if constexpr (D::values) add_by_value<Basis::chebyshev>(at.value[c], here, sums[c]);
          if constexpr (D::slopes) add_by_gradient<Basis::chebyshev>(at.slope[c], here, sums[c]);
        }
    }
    if constexpr (writes)
      for (int c = 0; c < C; ++c) write_sums<P>(sums[c], lane, values.value[c]);
  }

  static Block block_at(std::int64_t first, std::int64_t last) {
    if constexpr (single)
      return {first, std::min(first + 1, last - 1)};
    else
      return first;
  }

  /// Leave out the second share of a block that is there twice.
  static void drop_second(AtPoint<C, Vector>& at) {
    auto const drop = [](Vector& v) {
      for (int n = 0; n < native_lane_count; ++n) v[native_lane_count + n] = 0;
    };
    for (int c = 0; c < C; ++c) {
      if constexpr (D::values) drop(at.value[c]);
      if constexpr (D::slopes)
        for (Vector& slope : at.slope[c]) drop(slope);
    }
  }
};

// Not inline, so that it is compiled where it is instantiated and nowhere else.
template <int P, int C, class D, bool single>
void AtPoints<P, C, D, single>::operator()(LocalIndex const* elements, int count, GroupValues<P, C>& values) const {
  if constexpr (reads)
    for (int c = 0; c < C; ++c) transform(from_nodes, values.value[c]);
  V const size = single ? largest(values) : V{};
  if constexpr (single) multiply(V{} + Real(1) / size, values);
  for (int lane = 0; lane < count; ++lane) element(elements[lane], lane, values);
  if constexpr (single) multiply(size, values);
  if constexpr (writes)
    for (int c = 0; c < C; ++c) transform(to_nodes, values.value[c]);
}

// With any function of three components' slopes. `f` is extern, or empty where these are compiled.
#define AMRPIC_AT_POINTS_OF_SLOPES(f)                      \
  f template struct AtPoints<2, 3, AnyOfSlopes<3, false>>; \
  f template struct AtPoints<3, 3, AnyOfSlopes<3, false>>; \
  f template struct AtPoints<4, 3, AnyOfSlopes<3, false>>; \
  f template struct AtPoints<5, 3, AnyOfSlopes<3, false>>; \
  f template struct AtPoints<2, 3, AnyOfSlopes<3, true>>;  \
  f template struct AtPoints<3, 3, AnyOfSlopes<3, true>>;  \
  f template struct AtPoints<4, 3, AnyOfSlopes<3, true>>;  \
  f template struct AtPoints<5, 3, AnyOfSlopes<3, true>>;
AMRPIC_AT_POINTS_OF_SLOPES(extern)

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
