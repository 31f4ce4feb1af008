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
  V ends{};  ///< 1 for a flight of which a part alone lies between the ends of some field, else 0
  Vector3<V> electric_moment{},
      magnetic_moment{};  ///< ∫ E t dt and ∫ B t dt of those, V s²/m and T s²; see `moment_of`
  bool crossed = false;   ///< whether any flight gets something in a plane; if not, the rest has no values

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
};

/// The plane z = place + slope x.
struct Plane {
  Real place, slope = 0;

  template <class V>
  V height(Vector3<V> const& x) const {  ///< along z, of the plane that goes through x
    return slope == 0 ? x[2] : x[2] - slope * x[0];
  }
  Real steepness() const { return std::sqrt(1 + slope * slope); }  ///< most height per length of way
};

/// From a lower to an upper plane; may be infinite.
struct Slab {
  Plane lower, upper;
  bool everywhere() const { return std::isinf(lower.place) && std::isinf(upper.place); }
  bool is_straight() const { return lower.slope == 0 && upper.slope == 0; }

  /// The slab that is so much thicker at either face.
  Slab grown(Real by) const {
    return {{lower.place - by * lower.steepness(), lower.slope}, {upper.place + by * upper.steepness(), upper.slope}};
  }
};

template <class V>
auto contains(Slab const& slab, Vector3<V> const& x) {
  return (slab.lower.height(x) >= V{} + slab.lower.place) & (slab.upper.height(x) < V{} + slab.upper.place);
}

/// A flight as the segment between its ends.
template <class V>
struct Segment {
  Vector3<V> start, end, way;
  Real starts, lasts;  ///< s

  explicit Segment(Flight<V> const& f)
      : start(at(f, f.from)), end(at(f, f.to)), starts(f.time + f.from), lasts(f.to - f.from) {
    for (std::size_t d = 0; d < 3; ++d) way[d] = end[d] - start[d];
  }
  Vector3<V> point(V const& s) const { return sum(start, scaled(s, way)); }  ///< after the share `s` of its length
  V time(V const& s) const { return starts + s * lasts; }                    ///< s, then
  auto meets(Slab const& slab) const {
    auto const &lower = slab.lower, &upper = slab.upper;
    return (greater(lower.height(start), lower.height(end)) >= V{} + lower.place) &
           (V{} + upper.place >= lesser(upper.height(start), upper.height(end)));
  }
  auto lies_in(Slab const& slab) const { return contains(slab, start) & contains(slab, end); }

  /// Across a plane; what does not move counts as moving up, so slowly that it arrives nowhere.
  V rise(Plane const& plane) const {
    V const rise = plane.height(way);
    return select(rise == V{}, V{} + 1e-300, rise);
  }
  V share_before(Plane const& plane) const { return (plane.place - plane.height(start)) / rise(plane); }

  static Vector3<V> at(Flight<V> const& f, Real tau) {
    return {f.x[0] + f.v[0] * tau, f.x[1] + f.v[1] * tau, f.x[2] + f.v[2] * tau};
  }
};

/// The part of a segment between two planes: its share of the whole, and the place and the time (s) of its middle.
template <class V>
struct SegmentPart {
  V share;
  Vector3<V> middle;
  V time;
};

template <class V>
SegmentPart<V> part_inside(Slab const& slab, Segment<V> const& segment) {
  V const to_lower = segment.share_before(slab.lower), to_upper = segment.share_before(slab.upper);
  auto const from_above = segment.rise(slab.lower) < V{}, to_below = segment.rise(slab.upper) < V{};
  V const first = clamped(greater(select(from_above, V{}, to_lower), select(to_below, to_upper, V{})), 0, 1);
  V const last = clamped(lesser(select(from_above, to_lower, V{} + 1), select(to_below, V{} + 1, to_upper)), 0, 1);
  V const middle = 0.5 * (first + last);
  return {greater(last - first, V{}), segment.point(middle), segment.time(middle)};
}

/// ∫ t dt, in s², over the part of a flight between two planes, t from the place where steps meet: the change of
/// velocity on it counts from its own time on. What lies between them at the other end of the flight, in the middle of
/// a drift, is taken to go on in the other half of that, whose change of velocity counts from where steps meet: that
/// half is included, with the opposite sign. So flights that lie between the planes all along have none.
template <class V>
V moment_of(Slab const& slab, Segment<V> const& segment, SegmentPart<V> const& part, Flight<V> const& flight) {
  Real const lasts = flight.to - flight.from, sign = flight.from < 0 ? -1 : 1;
  auto const goes_on = contains(slab, sign < 0 ? segment.start : segment.end);
  return part.share * lasts * (part.time - flight.time) - zero_unless(goes_on, V{} + sign * lasts * lasts / 2);
}

/// 1 if a segment crosses a plane upwards, -1 downwards, else 0: by the sides of its ends alone, so that of segments
/// that follow each other one crosses.
template <class V>
V direction_across(Plane const& plane, Segment<V> const& segment) {
  auto const below = [&](Vector3<V> const& x) { return zero_unless(plane.height(x) < V{} + plane.place, V{} + 1); };
  return below(segment.start) - below(segment.end);
}

}  // namespace external
}  // namespace amrpic
