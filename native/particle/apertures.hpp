#pragma once

#include <cstdint>
#include <limits>
#include <vector>

#include "base/types.hpp"
#include "external/flight.hpp"

namespace amrpic {

/// Axes of what flights meet, and how far from its z they do.
struct Whereabouts {
  Real3 origin{};  ///< m, in the laboratory
  std::array<Real3, 3> axis{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
  Real reach = std::numeric_limits<Real>::infinity();  ///< m, of places where flights start

  bool is_laboratory() const { return origin == Real3{} && axis == Whereabouts{}.axis && std::isinf(reach); }
};

/// Solid between two planes of constant z, which may lie at infinity, with a hole along z.
struct Aperture {
  enum class Hole { ellipse, rectangle };

  Hole hole;
  std::array<Real, 2> centre;      ///< of the hole in x and y, m
  std::array<Real, 2> half_width;  ///< m
  external::Interval z;            ///< m
  Whereabouts where{};             ///< of these coordinates
};

/// A plane of constant z.
struct Screen {
  Real z;  ///< m
  Whereabouts where{};
};

/// Straight flights of particles, whose places were taken in axes that moved: those of the laboratory are offset by
/// `start_offset` and `end_offset`.
struct Flights {
  std::int64_t count;
  std::array<Real*, 3> start, end;  ///< m
  Real3 start_offset, end_offset;   ///< m
};

/// Flight number `flight` meets aperture or plane number `what` after the share `share` of its way.
struct Encounter {
  std::int64_t flight;
  int what;
  Real share;
};

/// For each flight that touches the solid of an aperture the first place where it does: at once if it starts there. Of
/// apertures that are met at the same place the first one counts. A wall of a hole is still in the hole.
std::vector<Encounter> first_encounters(std::vector<Aperture> const& apertures, Flights const& flights);

/// Where flights cross screens, flight by flight. Of flights that follow each other one crosses.
std::vector<Encounter> crossings(std::vector<Screen> const& screens, Flights const& flights);

}  // namespace amrpic
