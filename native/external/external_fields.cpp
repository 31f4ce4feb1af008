#include "external/external_fields.hpp"

#include <algorithm>
#include <limits>

namespace amrpic {

using namespace external;

namespace {

constexpr Real infinity = std::numeric_limits<Real>::infinity();

Real lowest(Real x) { return x; }
Real highest(Real x) { return x; }
Real lowest(Lanes const& x) {
  Real out = x[0];
  for (int i = 1; i < lane_count; ++i) out = std::min(out, Real(x[i]));
  return out;
}
Real highest(Lanes const& x) {
  Real out = x[0];
  for (int i = 1; i < lane_count; ++i) out = std::max(out, Real(x[i]));
  return out;
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
Flight<V> seen_from(Frame const& frame, bool turned, Flight<V> const& f) {
  Flight<V> out = f;
  for (std::size_t d = 0; d < 3; ++d) out.x[d] = f.x[d] - frame.origin[d];
  if (turned) out.x = along_axes(frame, out.x), out.v = along_axes(frame, f.v);
  return out;
}

/// What the planes at both ends of a field give to flights that cross them.
template <class V, class Of>
Edges<V> edges_of(Of const& of, Interval const& extent, Flight<V> const& flight) {
  Segment<V> const segment(flight);
  Edges<V> out;
  out.normal = {};
  auto const add = [&](Real plane, Real sign) {
    V const direction = direction_across(plane, segment);
    if (all(direction == V{})) return;
    V const density = direction / segment.dz();                                // the mean of δ(z - plane)
    V const share = clamped((plane - segment.start[2]) / segment.dz(), 0, 1);  // of the segment before the plane
    V const tau = flight.from + share * (flight.to - flight.from);
    auto const B = scaled<V>(sign * density, edge_field<V>(of, segment.point(share)));
    auto const enters = sign * direction > V{};
    for (std::size_t d = 0; d < 3; ++d) {
      out.first[d] += select(enters, B[d], V{});
      out.last[d] += select(enters, V{}, B[d]);
      out.moment[d] += tau * B[d];
    }
    out.normal[2] = select(sign * direction < V{}, V{} + 1, out.normal[2]);
    out.crossed = true;
  };
  add(extent.lower, 1);
  add(extent.upper, -1);
  return out;
}

/// The mean of one field along a flight in its own axes.
template <class V, class Of>
Fields<V> mean_field(Of const& of, Interval const& extent, Flight<V> const& flight) {
  if (!of.is_hard() || extent.everywhere()) {
    auto const here = contains(extent, flight.x[2]);
    if (!any(here)) return {};
    auto out = field(of, flight.x, flight.time);
    for (std::size_t d = 0; d < 3; ++d)
      out.E[d] = zero_unless<V>(here, out.E[d]), out.B[d] = zero_unless<V>(here, out.B[d]);
    return out;
  }
  Segment<V> const segment(flight);
  if (!any(segment.meets(extent))) return {};
  auto const part = part_inside(extent, segment);
  auto out = field(of, part.middle, flight.time);
  out.E = scaled(part.share, out.E), out.B = scaled(part.share, out.B);
  return out;
}

}  // namespace

Interval external::laboratory_extent(Element const& element) {
  Frame const& frame = element.frame;
  Real const along = frame.axis[2][2], z = frame.origin[2];
  if (std::abs(along) != 1) return {-infinity, infinity};  // a tilted slab passes every z somewhere
  auto const [lower, upper] = along > 0 ? element.extent : Interval{-element.extent.upper, -element.extent.lower};
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

std::size_t ExternalFields::first_near(Real lower) const {
  auto const found = std::lower_bound(entries_.begin(), entries_.end(), lower,
                                      [](Entry const& entry, Real z) { return entry.highest < z; });
  return std::size_t(found - entries_.begin());
}

template <class V>
void add_mean_field(ExternalFields const& fields, Flight<V> const& flight, Vector3<V>& E, Vector3<V>& B,
                    Edges<V>& edges) {
  V const start = flight.x[2] + flight.v[2] * flight.from, end = flight.x[2] + flight.v[2] * flight.to;
  fields.for_each_near(lowest(lesser(start, end)), highest(greater(start, end)), [&](Element const& at, bool turned) {
    auto const local = seen_from(at.frame, turned, flight);
    auto const to_laboratory = [&](Vector3<V> const& a) { return turned ? in_laboratory(at.frame, a) : a; };
    std::visit(
        [&](auto const& of) {
          auto const mean = mean_field(of, at.extent, local);
          E = sum(E, to_laboratory(mean.E)), B = sum(B, to_laboratory(mean.B));
          if constexpr (std::decay_t<decltype(of)>::has_edges) {
            if (!of.is_hard()) return;
            auto const crossed = edges_of(of, at.extent, local);
            if (!crossed.crossed) return;
            auto const leaves = crossed.normal[2] > V{};
            auto const normal = to_laboratory(crossed.normal);
            for (std::size_t d = 0; d < 3; ++d) edges.normal[d] = select(leaves, normal[d], edges.normal[d]);
            edges.first = sum(edges.first, to_laboratory(crossed.first));
            edges.last = sum(edges.last, to_laboratory(crossed.last));
            edges.moment = sum(edges.moment, to_laboratory(crossed.moment));
            edges.crossed = true;
          }
        },
        at.kind);
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
