#include "external/external_fields.hpp"

#include <algorithm>
#include <limits>

namespace amrpic {

using namespace external;

namespace {

constexpr Real infinity = std::numeric_limits<Real>::infinity();

Real lowest(Real x) { return x; }
Real highest(Real x) { return x; }
/// One number of eight: of two halves, then of four numbers.
template <class Vector, class Of>
Real reduced(Vector const& x, Of const& of) {
  HalfLanes low, high;
  if constexpr (std::is_class_v<Vector>) {
    low = x.low, high = x.high;
  } else {
    low = __builtin_shufflevector(x, x, 0, 1, 2, 3), high = __builtin_shufflevector(x, x, 4, 5, 6, 7);
  }
  HalfLanes const four = of(low, high);
  return of(of(four[0], four[1]), of(four[2], four[3]));
}
Real lowest(Lanes const& x) {
  return reduced(x, [](auto const& a, auto const& b) { return a < b ? a : b; });
}
Real highest(Lanes const& x) {
  return reduced(x, [](auto const& a, auto const& b) { return a > b ? a : b; });
}

/// A vector of the laboratory along the axes of a frame.
template <class V>
Vector3<V> along_axes(Frame const& frame, Vector3<V> const& a) {
  return {dot(frame.axis[0], a), dot(frame.axis[1], a), dot(frame.axis[2], a)};
}
/// The opposite.
template <class V>
Vector3<V> in_laboratory(Frame const& frame, Vector3<V> const& a) {
  auto const& [x, y, z] = frame.axis;
  Vector3<V> out;
  for (std::size_t d = 0; d < 3; ++d) out[d] = x[d] * a[0] + y[d] * a[1] + z[d] * a[2];
  return out;
}

template <class V>
Vector3<V> place_seen_from(Frame const& frame, bool turned, Vector3<V> const& x) {
  Vector3<V> const out{x[0] - frame.origin[0], x[1] - frame.origin[1], x[2] - frame.origin[2]};
  return turned ? along_axes(frame, out) : out;
}

template <class V>
Flight<V> flight_seen_from(Frame const& frame, bool turned, Flight<V> const& f) {
  Flight<V> out = f;
  out.x = place_seen_from(frame, turned, f.x);
  if (turned) out.v = along_axes(frame, f.v);
  return out;
}

/// Whether places in an element's own axes are near enough to its z.
template <class V>
auto in_reach(Element const& element, Vector3<V> const& x) {
  return V{} + element.reach >= square_root(x[0] * x[0] + x[1] * x[1]);
}

/// Where fields and edges of elements are added up, in the axes of the laboratory.
template <class V>
struct Sums {
  Vector3<V>&E, &B;
  Edges<V>& edges;
};

/// Add what the planes at both ends of a field give to those `near` flights that cross them.
template <class V, class Of, class Turn, class Mask>
void add_edges(Of const& of, Slab const& extent, Flight<V> const& flight, Segment<V> const& segment, Mask const& near,
               Turn const& to_laboratory, Edges<V>& edges) {
  auto const add = [&](Plane const& plane, Real sign) {
    V const direction = zero_unless(near, direction_across(plane, segment));
    if (all(direction == V{})) return;
    V const density = direction / segment.rise(plane);  // the mean of δ(height - place)
    V const share = clamped(segment.share_before(plane), 0, 1);
    V const tau = flight.from + share * (flight.to - flight.from);
    auto const B = to_laboratory(scaled<V>(sign * density, edge_field<V>(of, plane, segment.point(share))));
    Real const per_length = 1 / plane.steepness();
    auto const normal = to_laboratory({V{} - plane.slope * per_length, V{}, V{} + per_length});
    auto const enters = sign * direction > V{}, leaves = sign * direction < V{};
    edges.begin();
    edges.entered = select(enters, tau, edges.entered);
    edges.left = select(leaves, tau, edges.left);
    for (std::size_t d = 0; d < 3; ++d) {
      edges.first[d] += select(enters, B[d], V{});
      edges.last[d] += select(leaves, B[d], V{});
      edges.normal[d] = select(direction == V{}, edges.normal[d], normal[d]);
    }
  };
  add(extent.lower, 1);
  add(extent.upper, -1);
}

/// Add the mean of the field of an element along a flight in its own axes.
template <class V, class Of, class Turn>
void add_one(Of const& of, Element const& element, Flight<V> const& flight, Turn const& to_laboratory,
             Sums<V> const& to) {
  Slab const& extent = element.extent;
  auto const near = in_reach(element, flight.x);
  auto const add = [&](Fields<V> const& mean) {
    if (of.electric()) to.E = sum(to.E, to_laboratory(mean.E));
    if (of.magnetic()) to.B = sum(to.B, to_laboratory(mean.B));
  };
  if (!of.is_hard() || extent.everywhere()) {
    auto const here = contains(extent, flight.x) & near;
    if (!any(here)) return;
    auto mean = field(of, flight.x, flight.time);
    for (std::size_t d = 0; d < 3; ++d)
      mean.E[d] = zero_unless<V>(here, mean.E[d]), mean.B[d] = zero_unless<V>(here, mean.B[d]);
    return add(mean);
  }
  Segment<V> const segment(flight);
  auto const meets = segment.meets(extent) & near, inside = segment.lies_in(extent) & near;
  if (!any(meets)) return;
  V const half = V{} + 0.5;
  if (all(inside)) return add(field(of, segment.point(half), segment.time(half)));
  auto part = part_inside(extent, segment);
  part.share = zero_unless(near, part.share);
  auto const mean = field(of, part.middle, part.time);
  add({scaled(part.share, mean.E), scaled(part.share, mean.B)});
  V const moment = zero_unless(meets, moment_of(extent, segment, part, flight));
  if (of.electric()) to.edges.electric_moment = sum(to.edges.electric_moment, to_laboratory(scaled(moment, mean.E)));
  if (of.magnetic()) to.edges.magnetic_moment = sum(to.edges.magnetic_moment, to_laboratory(scaled(moment, mean.B)));
  to.edges.ends = select(inside, to.edges.ends, select(meets, V{} + 1, to.edges.ends));
  if constexpr (Of::has_edges) add_edges(of, extent, flight, segment, near, to_laboratory, to.edges);
}

/// Whether a field is the same all over its extent.
template <class Of>
bool is_uniform(Of const&) {
  return false;
}
bool is_uniform(Uniform const&) { return true; }
bool is_uniform(Dipole const& of) { return of.is_hard() && of.gradient == 0; }
bool is_uniform(Solenoid const& of) { return of.is_hard(); }

/// Add one field at places that all lie inside its extent, whose axes are those of the laboratory.
template <class Of>
void add_inside(Of const& of, Frame const& frame, Real time, Places& at) {
  Fields<Lanes> there;
  for (std::size_t n = 0; n < at.count; ++n) {
    if (n == 0 || !is_uniform(of)) there = field(of, place_seen_from(frame, false, at.x[n]), time);
    if (of.electric()) at.E[n] = sum(at.E[n], there.E);
    if (of.magnetic()) at.B[n] = sum(at.B[n], there.B);
  }
}

/// Add one field at places of which z lies in an interval. Return whether any is nearer to a hard end than `reach`.
template <class Of>
bool add_at(Of const& of, Element const& element, Interval const& z, bool turned, Real time, Real reach, Places& at) {
  Slab const &extent = element.extent, around = extent.grown(reach), inside = extent.grown(-reach);
  Real const origin = element.frame.origin[2];
  bool const wide = std::isinf(element.reach);
  bool const whole = wide && (extent.everywhere() || (extent.is_straight() && z.lower >= origin + inside.lower.place &&
                                                      z.upper < origin + inside.upper.place));
  if (whole && !turned) {
    add_inside(of, element.frame, time, at);
    return false;
  }
  bool const ends = of.is_hard() && !extent.everywhere();
  Lanes any_near{};
  for (std::size_t n = 0; n < at.count; ++n) {
    Vector3<Lanes> const x = place_seen_from(element.frame, turned, at.x[n]);
    auto const reached = in_reach(element, x);
    if (ends) {
      Lanes const near = zero_unless(contains(around, x) & reached, select(contains(inside, x), Lanes{}, Lanes{} + 1));
      at.near_end[n] += near;
      any_near += near;
    }
    auto const add = [&](Vector3<Lanes>& sums, Vector3<Lanes> const& own) {
      Vector3<Lanes> const more = turned ? in_laboratory(element.frame, own) : own;
      for (std::size_t d = 0; d < 3; ++d) sums[d] += zero_unless(contains(extent, x) & reached, more[d]);
    };
    auto const there = field(of, x, time);
    if (of.electric()) add(at.E[n], there.E);
    if (of.magnetic()) add(at.B[n], there.B);
  }
  return any(any_near > Lanes{});
}

}  // namespace

bool ExternalFields::add_field(Real time, Real reach, Places& at) const {
  Lanes low = at.x[0][2], high = low;
  for (std::size_t n = 0; n < at.count; ++n) {
    low = lesser(low, at.x[n][2]), high = greater(high, at.x[n][2]);
    at.near_end[n] = Lanes{};
  }
  Interval const z{lowest(low), highest(high)};
  bool near = false;
  for_each_near(z.lower - reach, z.upper + reach, [&](Element const& element, bool turned) {
    near |= std::visit([&](auto const& of) { return add_at(of, element, z, turned, time, reach, at); }, element.kind);
  });
  return near;
}

Interval external::laboratory_extent(Element const& element) {
  Frame const& frame = element.frame;
  Real const along = frame.axis[2][2], z = frame.origin[2];
  auto const [first, last] = element.extent;
  bool const across = std::abs(along) == 1 && first.slope == 0 && last.slope == 0;
  // a tilted plane passes every z somewhere, where there is no end across
  if (!across && (std::isinf(element.reach) || std::isinf(first.place) || std::isinf(last.place)))
    return {-infinity, infinity};
  Real const rise = across ? 0 : element.reach * std::hypot(frame.axis[0][2], frame.axis[1][2]);
  auto const tilt = [&](Plane const& plane) { return plane.slope == 0 ? 0 : std::abs(plane.slope) * element.reach; };
  Interval own{first.place - tilt(first), last.place + tilt(last)};
  if (along < 0) own = {-own.upper, -own.lower};
  Real const lower = across ? own.lower : std::abs(along) * own.lower - rise,
             upper = across ? own.upper : std::abs(along) * own.upper + rise;
  auto const rounding = [=](Real end) { return 1e-14 * (std::abs(z) + std::abs(end)); };  // of places in either axes
  return {z + lower - rounding(lower), z + upper + rounding(upper)};
}

ExternalFields::ExternalFields(std::vector<Element> elements) {
  for (Element& element : elements) {
    electric_ = electric_ || std::visit([](auto const& of) { return of.electric(); }, element.kind);
    magnetic_ = magnetic_ || std::visit([](auto const& of) { return of.magnetic(); }, element.kind);
    Interval const z = laboratory_extent(element);
    bool const turned = element.frame.is_turned();
    entries_.push_back({std::move(element), z, infinity, turned});
  }
  std::stable_sort(entries_.begin(), entries_.end(),
                   [](Entry const& a, Entry const& b) { return a.z.lower < b.z.lower; });
  Real highest = -infinity;
  for (Entry& entry : entries_) entry.highest = highest = std::max(highest, entry.z.upper);
}

ExternalFields ExternalFields::seen_from(Frame const& frame) const {
  std::vector<Element> elements;
  for (Entry const& entry : entries_) {
    Element seen = entry.element;
    for (std::size_t d = 0; d < 3; ++d) seen.frame.origin[d] -= frame.origin[d];
    if (frame.is_turned()) {
      seen.frame.origin = along_axes(frame, seen.frame.origin);
      for (Real3& axis : seen.frame.axis) axis = along_axes(frame, axis);
    }
    elements.push_back(std::move(seen));
  }
  return ExternalFields(std::move(elements));
}

std::size_t ExternalFields::first_near(Real lower) const {
  auto const found = std::lower_bound(entries_.begin(), entries_.end(), lower,
                                      [](Entry const& entry, Real z) { return entry.highest < z; });
  return std::size_t(found - entries_.begin());
}

template <class V>
void add_mean_field(ExternalFields const& fields, Flight<V> const& flight, Vector3<V>& E, Vector3<V>& B,
                    Edges<V>& edges) {
  if (fields.empty()) return;
  V const start = flight.x[2] + flight.v[2] * flight.from, end = flight.x[2] + flight.v[2] * flight.to;
  Sums<V> const sums{E, B, edges};
  fields.for_each_near(lowest(lesser(start, end)), highest(greater(start, end)), [&](Element const& at, bool turned) {
    auto const to_laboratory = [&](Vector3<V> const& a) { return turned ? in_laboratory(at.frame, a) : a; };
    auto const local = flight_seen_from(at.frame, turned, flight);
    std::visit([&](auto const& of) { add_one(of, at, local, to_laboratory, sums); }, at.kind);
  });
}

template <class V>
void add_mean_field(ExternalFields const& fields, Flight<V> const& flight, Vector3<V>& E, Vector3<V>& B) {
  Edges<V> edges;
  add_mean_field(fields, flight, E, B, edges);
  if (edges.crossed) B = sum(B, sum(edges.first, edges.last));
}

template void add_mean_field(ExternalFields const&, Flight<Real> const&, Vector3<Real>&, Vector3<Real>&, Edges<Real>&);
template void add_mean_field(ExternalFields const&, Flight<Lanes> const&, Vector3<Lanes>&, Vector3<Lanes>&,
                             Edges<Lanes>&);
template void add_mean_field(ExternalFields const&, Flight<Real> const&, Vector3<Real>&, Vector3<Real>&);
template void add_mean_field(ExternalFields const&, Flight<Lanes> const&, Vector3<Lanes>&, Vector3<Lanes>&);

}  // namespace amrpic
