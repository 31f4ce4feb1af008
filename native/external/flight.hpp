// Straight flights, and their parts inside an element.
#pragma once

#include "external/value.hpp"

namespace amrpic {

/// Places x + v τ in m, v in m/s, for τ from `from` to `to` (s) around `time` (s).
template <class V>
struct Flight {
  Vector3<V> x, v;
  Real time, from, to;
};

/// What becomes of flights at the ends of fields: means of B in the planes where these begin or end at once.
template <class V>
struct Edges {
  V ends{};              ///< 1 for a flight of which a part alone lies between the ends of some field, else 0
  bool crossed = false;  ///< whether any flight gets something in a plane; if not, the rest has no values

  Vector3<V> first, last;  ///< T; in planes where a flight enters a field, and where it leaves it
  V entered, left;         ///< s, when
  Vector3<V> normal;       ///< of these planes

  void begin() {
    if (crossed) return;
    first = last = {};
    entered = left = V{};
    normal = {V{}, V{}, V{} + 1};
    crossed = true;
  }
};

namespace external {

/// From a lower to an upper number; may be infinite.
struct Interval {
  Real lower, upper;
  bool everywhere() const { return std::isinf(lower) && std::isinf(upper); }
};

template <class V>
auto contains(Interval const& interval, V const& x) {
  return (x >= V{} + interval.lower) & (x < V{} + interval.upper);
}

/// A flight as the segment between its ends.
template <class V>
struct Segment {
  Vector3<V> start, way;
  V end_z;

  explicit Segment(Flight<V> const& f) : start(at(f, f.from)) {
    Vector3<V> const end = at(f, f.to);
    for (std::size_t d = 0; d < 3; ++d) way[d] = end[d] - start[d];
    end_z = end[2];
  }
  Vector3<V> point(V const& s) const { return sum(start, scaled(s, way)); }  ///< after the share `s` of its length
  auto meets(Interval const& z) const {
    return (greater(start[2], end_z) >= V{} + z.lower) & (V{} + z.upper >= lesser(start[2], end_z));
  }
  auto lies_in(Interval const& z) const { return contains(z, start[2]) & contains(z, end_z); }
  V dz() const { return select(way[2] == V{}, V{} + 1, way[2]); }  ///< along z, to divide by

  static Vector3<V> at(Flight<V> const& f, Real tau) {
    return {f.x[0] + f.v[0] * tau, f.x[1] + f.v[1] * tau, f.x[2] + f.v[2] * tau};
  }
};

/// The part of a segment between two planes of constant z: its share of the whole, and its middle.
template <class V>
struct Part {
  V share;
  Vector3<V> middle;
};

template <class V>
Part<V> part_inside(Interval const& z, Segment<V> const& segment) {
  V const to_lower = (z.lower - segment.start[2]) / segment.dz(),
          to_upper = (z.upper - segment.start[2]) / segment.dz();
  V const first = clamped(lesser(to_lower, to_upper), 0, 1), last = clamped(greater(to_lower, to_upper), 0, 1);
  auto const rests = segment.way[2] == V{};
  V const inside = zero_unless(contains(z, segment.start[2]), V{} + 1);
  return {select(rests, inside, last - first), segment.point(select(rests, V{} + 0.5, 0.5 * (first + last)))};
}

/// 1 if a segment crosses a plane of constant z upwards, -1 downwards, else 0: by the sides of its ends alone, so that
/// of segments that follow each other one crosses.
template <class V>
V direction_across(Real plane, Segment<V> const& segment) {
  auto const below = [&](V const& z) { return zero_unless(z < V{} + plane, V{} + 1); };
  return below(segment.start[2]) - below(segment.end_z);
}

}  // namespace external
}  // namespace amrpic
