// The parts of a beam that are measured by themselves: bunches, species, slices of these.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "base/constants.hpp"
#include "particle/view.hpp"

namespace amrpic {

/// Particles of this rank, and what gives their momenta at the time of their positions.
struct BeamView {
  ParticleView particles;
  Real const* mass;  ///< kg: one value for all if they have the `same`, else one for each
  bool same;
  std::array<Real*, 3> later;  ///< momenta of the same particles at a later time
  Real share;                  ///< of `later` in the mean with those of the particles
};

/// Eight particles with momenta at the time of their positions.
struct BeamLanes {
  Lanes weight, mass;         ///< real particles; kg
  std::array<Lanes, 3> x, u;  ///< position, m; momentum over m c
};

inline BeamLanes load(BeamView const& beam, LaneGroup const& group) {
  BeamLanes out{
      load(beam.particles.weight, beam.particles.equal_weights, group), load(beam.mass, beam.same, group), {}, {}};
  Lanes const per_mc = 1 / (out.mass * speed_of_light);
  for (std::size_t d = 0; d < 3; ++d) {
    Lanes const early = load(beam.particles.momentum[d], group);
    out.x[d] = load(beam.particles.position[d], group);
    out.u[d] = (early + beam.share * (load(beam.later[d], group) - early)) * per_mc;
  }
  return out;
}

/// J; u² / (gamma + 1) equals gamma - 1 and loses no digits when particles are slow.
inline Lanes kinetic_energy(BeamLanes const& of) {
  Lanes const square = of.u[0] * of.u[0] + of.u[1] * of.u[1] + of.u[2] * of.u[2];
  return of.mass * (speed_of_light * speed_of_light) * (square / (square_root(1 + square) + 1));
}

/// Runs of ids form groups, and each group may be cut along z into slices of equal length. Ids from starts[r] to
/// starts[r + 1] - 1 are of group groups[r], or of none if that is negative.
struct BeamParts {
  std::vector<std::int64_t> starts;
  std::vector<int> groups;
  std::vector<Real> lower;       ///< of the first slice of each group, m
  std::vector<Real> per_length;  ///< slices per m of each group
  int slices = 1;

  std::size_t count() const { return lower.size() * std::size_t(slices); }

  /// The part that a particle belongs to, or -1. The slices at both ends hold what lies beyond them.
  int part_of(std::int64_t id, Real z) const {
    std::size_t run = 0;
    if (starts.size() > 1) run = std::size_t(std::upper_bound(starts.begin(), starts.end(), id) - starts.begin()) - 1;
    int const group = groups[run];
    if (group < 0 || slices == 1) return group;
    Real const place = std::floor((z - lower[std::size_t(group)]) * per_length[std::size_t(group)]);
    return group * slices + int(std::clamp<Real>(place, 0, slices - 1));
  }
  bool is_one() const { return starts.size() == 1 && slices == 1; }
};

/// Call each(part, values, lane) for the particles of a beam that belong to a part, or whole(part, values) for eight of
/// one part.
template <class Whole, class Each>
void for_each_of_parts(BeamView const& beam, BeamParts const& parts, Whole&& whole, Each&& each) {
  std::int64_t const count = beam.particles.count;
  for (std::int64_t first = 0; first < count; first += lane_count) {
    int const present = int(std::min<std::int64_t>(lane_count, count - first));
    LaneGroup const group{first, (1u << present) - 1};
    BeamLanes const values = load(beam, group);
    std::array<int, lane_count> part;
    part.fill(parts.groups[0]);
    bool together = group.whole();
    if (!parts.is_one())
      for (int i = 0; i < present; ++i) {
        part[std::size_t(i)] = parts.part_of(beam.particles.id[first + i], values.x[2][i]);
        together = together && part[std::size_t(i)] == part[0];
      }
    if (together) {
      if (part[0] >= 0) whole(std::size_t(part[0]), values);
    } else {
      for (int i = 0; i < present; ++i)
        if (part[std::size_t(i)] >= 0) each(std::size_t(part[std::size_t(i)]), values, i);
    }
  }
}

}  // namespace amrpic
