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

/// Along axes on which space repeats after `period`, the image of a place that is nearest to a centre; along others,
/// whose period is 0, the place itself.
struct NearestImages {
  Real3 centre{}, period{};

  template <class T>
  T along(std::size_t d, T const& x) const {
    if (period[d] == 0) return x;
    return x - period[d] * round_down((x - centre[d]) * (1 / period[d]) + Real(0.5));
  }
};

/// Runs of ids form groups, and each group may be cut along z into slices of equal length. Ids from starts[r] to
/// starts[r + 1] - 1 are of group groups[r], or of none if that is negative.
struct BeamParts {
  std::vector<std::int64_t> starts;
  std::vector<int> groups;
  std::vector<Real> lower;       ///< of the first slice of each group, m
  std::vector<Real> per_length;  ///< slices per m of each group
  int slices = 1;
  std::vector<NearestImages> images{};  ///< that stand for the particles of each group; none: their places do

  std::size_t count() const { return lower.size() * std::size_t(slices); }

  /// The group that a particle belongs to, or -1.
  int group_of(std::int64_t id) const {
    std::size_t run = 0;
    if (starts.size() > 1) run = std::size_t(std::upper_bound(starts.begin(), starts.end(), id) - starts.begin()) - 1;
    return groups[run];
  }
  /// The part of a group at a place. The slices at both ends hold what lies beyond them.
  int part_of(int group, Real z) const {
    if (group < 0 || slices == 1) return group;
    Real const place = std::floor((z - lower[std::size_t(group)]) * per_length[std::size_t(group)]);
    return group * slices + int(std::clamp<Real>(place, 0, slices - 1));
  }
  bool is_one_run() const { return starts.size() == 1; }
};

/// Replace the places of eight particles by the images that stand for them in their groups.
inline void move_to_images(BeamLanes& of, BeamParts const& parts, std::array<int, lane_count> const& group) {
  for (std::size_t i = 0; i < lane_count;) {
    std::size_t next = i + 1;  // behind those of one group, which mostly are all
    while (next < lane_count && group[next] == group[i]) ++next;
    unsigned const which = ((1u << next) - 1) & ~((1u << i) - 1);
    if (group[i] >= 0)
      for (std::size_t d = 0; d < 3; ++d)
        of.x[d] = select(mask_of(which), parts.images[std::size_t(group[i])].along(d, of.x[d]), of.x[d]);
    i = next;
  }
}

/// Call each(part, values, lane) for the particles of a beam that belong to a part, or whole(part, values) for eight of
/// one part.
template <class Whole, class Each>
void for_each_of_parts(BeamView const& beam, BeamParts const& parts, Whole&& whole, Each&& each) {
  std::int64_t const count = beam.particles.count;
  for (std::int64_t first = 0; first < count; first += lane_count) {
    int const present = int(std::min<std::int64_t>(lane_count, count - first));
    LaneGroup const group{first, (1u << present) - 1};
    BeamLanes values = load(beam, group);
    std::array<int, lane_count> part;
    part.fill(parts.groups[0]);
    if (!parts.is_one_run())
      for (int i = 0; i < present; ++i) part[std::size_t(i)] = parts.group_of(beam.particles.id[first + i]);
    if (!parts.images.empty()) move_to_images(values, parts, part);
    if (parts.slices > 1)
      for (int i = 0; i < present; ++i) part[std::size_t(i)] = parts.part_of(part[std::size_t(i)], values.x[2][i]);
    bool together = group.whole();
    for (int i = 1; i < present; ++i) together = together && part[std::size_t(i)] == part[0];
    if (together) {
      if (part[0] >= 0) whole(std::size_t(part[0]), values);
    } else {
      for (int i = 0; i < present; ++i)
        if (part[std::size_t(i)] >= 0) each(std::size_t(part[std::size_t(i)]), values, i);
    }
  }
}

}  // namespace amrpic
