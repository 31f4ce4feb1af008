#include "particle/apertures.hpp"

#include <algorithm>
#include <limits>

#include "base/vector3.hpp"
#include "particle/lane_groups.hpp"

namespace amrpic {

namespace {

constexpr Real infinity = std::numeric_limits<Real>::infinity();
using external::Interval;

constexpr Interval none{infinity, -infinity}, all{-infinity, infinity};

/// The shares of the way from `start` to `end` between two values.
Interval between(Real lower, Real upper, Real start, Real end) {
  Real const way = end - start;
  if (way == 0) return start >= lower && start <= upper ? all : none;
  Real const to_lower = (lower - start) / way, to_upper = (upper - start) / way;
  return {std::min(to_lower, to_upper), std::max(to_lower, to_upper)};
}

/// Those within the unit circle of a way in two dimensions: between the roots of a f² + 2 b f + c.
Interval in_circle(std::array<Real, 2> const& start, std::array<Real, 2> const& end) {
  Real const wx = end[0] - start[0], wy = end[1] - start[1];
  Real const a = wx * wx + wy * wy, b = start[0] * wx + start[1] * wy,
             c = start[0] * start[0] + start[1] * start[1] - 1;
  if (a == 0) return c <= 0 ? all : none;
  Real const square = b * b - a * c;
  if (square < 0) return none;
  Real const q = -(b + std::copysign(std::sqrt(square), b));  // without cancellation
  Real const one = q / a, other = q == 0 ? one : c / q;
  return {std::min(one, other), std::max(one, other)};
}

Interval in_hole(Aperture const& of, Real3 const& start, Real3 const& end) {
  std::array<Real, 2> from, to;  // in half widths from the centre
  for (std::size_t d = 0; d < 2; ++d) {
    from[d] = (start[d] - of.centre[d]) / of.half_width[d];
    to[d] = (end[d] - of.centre[d]) / of.half_width[d];
  }
  if (of.hole == Aperture::Hole::ellipse) return in_circle(from, to);
  Interval const x = between(-1, 1, from[0], to[0]), y = between(-1, 1, from[1], to[1]);
  return {std::max(x.lower, y.lower), std::min(x.upper, y.upper)};
}

/// The share of its way after which a flight is in the solid; infinity if it never is.
Real share_to_solid(Aperture const& of, Real3 const& start, Real3 const& end) {
  Interval const z = between(of.z.lower, of.z.upper, start[2], end[2]);
  Real const first = std::max(z.lower, Real(0)), last = std::min(z.upper, Real(1));
  if (!(first <= last)) return infinity;
  Interval const hole = in_hole(of, start, end);
  if (first < hole.lower || first > hole.upper) return first;
  return hole.upper < last ? hole.upper : infinity;
}

/// Eight flights in the laboratory, or in other axes.
struct EightFlights {
  Vector3<Lanes> start, end;

  EightFlights(Flights const& f, LaneGroup const& group) {
    for (std::size_t d = 0; d < 3; ++d) {
      start[d] = load(f.start[d], group) + f.start_offset[d];
      end[d] = load(f.end[d], group) + f.end_offset[d];
    }
  }
  EightFlights seen_from(Whereabouts const& where) const {
    EightFlights out = *this;
    for (auto const& [from, to] : {std::pair{&start, &out.start}, std::pair{&end, &out.end}}) {
      Vector3<Lanes> away;
      for (std::size_t d = 0; d < 3; ++d) away[d] = (*from)[d] - where.origin[d];
      for (std::size_t d = 0; d < 3; ++d) (*to)[d] = dot(where.axis[d], away);
    }
    return out;
  }
  /// A bit for each that starts near enough to z.
  unsigned in_reach(Real reach) const {
    Lanes const square = start[0] * start[0] + start[1] * start[1];
    return bits_of(Lanes{} + reach * reach >= square);
  }
  Real3 start_of(int i) const { return {start[0][i], start[1][i], start[2][i]}; }
  Real3 end_of(int i) const { return {end[0][i], end[1][i], end[2][i]}; }
};

/// A bit for each of eight places in the hole.
unsigned inside(Aperture const& of, Vector3<Lanes> const& at) {
  Lanes const x = (at[0] - of.centre[0]) / of.half_width[0], y = (at[1] - of.centre[1]) / of.half_width[1];
  Lanes const one = Lanes{} + 1, minus = Lanes{} - 1;
  if (of.hole == Aperture::Hole::ellipse) return bits_of(one >= x * x + y * y);
  return bits_of((one >= x) & (x >= minus) & (one >= y) & (y >= minus));
}

/// A bit for each of eight flights that may touch the solid: all do not that lie before or behind it, or that start and
/// end in its hole, which is convex.
unsigned may_touch(Aperture const& of, EightFlights const& f) {
  Lanes const low = external::lesser(f.start[2], f.end[2]), high = external::greater(f.start[2], f.end[2]);
  unsigned const near = bits_of((high >= Lanes{} + of.z.lower) & (Lanes{} + of.z.upper >= low));
  return near == 0 ? 0 : near & ~(inside(of, f.start) & inside(of, f.end));
}

/// Call f(eight flights as a thing at a place sees them, those of them that it is in reach of).
template <class F>
void seen_from(Whereabouts const& where, EightFlights const& eight, F&& f) {
  if (where.is_laboratory()) return f(eight, all_lanes);
  EightFlights const own = eight.seen_from(where);
  f(own, own.in_reach(where.reach));
}

template <class F>
void for_each_eight(Flights const& flights, F&& f) {
  for (std::int64_t first = 0; first < flights.count; first += lane_count) {
    std::int64_t const left = flights.count - first;
    LaneGroup const group{first, left < lane_count ? (1u << left) - 1 : all_lanes};
    f(group, EightFlights(flights, group));
  }
}

}  // namespace

std::vector<Encounter> first_encounters(std::vector<Aperture> const& apertures, Flights const& flights) {
  std::vector<Encounter> out;
  for_each_eight(flights, [&](LaneGroup const& group, EightFlights const& eight) {
    std::array<Real, lane_count> share;
    std::array<int, lane_count> what{};
    share.fill(infinity);
    unsigned met = 0;
    for (std::size_t a = 0; a < apertures.size(); ++a)
      seen_from(apertures[a].where, eight, [&](EightFlights const& own, unsigned in_reach) {
        for_each_bit(may_touch(apertures[a], own) & in_reach & group.lanes, [&](int i) {
          Real const found = share_to_solid(apertures[a], own.start_of(i), own.end_of(i));
          if (!(found < share[std::size_t(i)])) return;
          share[std::size_t(i)] = found;
          what[std::size_t(i)] = int(a);
          met |= 1u << i;
        });
      });
    for_each_bit(met, [&](int i) { out.push_back({group.first + i, what[std::size_t(i)], share[std::size_t(i)]}); });
  });
  return out;
}

std::vector<Encounter> crossings(std::vector<Screen> const& screens, Flights const& flights) {
  std::vector<Encounter> out;
  for_each_eight(flights, [&](LaneGroup const& group, EightFlights const& eight) {
    for (std::size_t s = 0; s < screens.size(); ++s)
      seen_from(screens[s].where, eight, [&](EightFlights const& own, unsigned in_reach) {
        Real const place = screens[s].z;
        auto const below = [&](Lanes const& z) { return bits_of(z < Lanes{} + place); };
        for_each_bit((below(own.start[2]) ^ below(own.end[2])) & in_reach & group.lanes, [&](int i) {
          Real const start = own.start[2][i], way = own.end[2][i] - start;
          out.push_back({group.first + i, int(s), (place - start) / way});
        });
      });
  });
  return out;
}

}  // namespace amrpic
