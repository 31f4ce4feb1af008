#include "particle/moments.hpp"

#include "base/communicator.hpp"
#include "base/constants.hpp"

namespace amrpic {

namespace {

/// Part i of eight.
BeamSums<Real> part(BeamSums<Lanes> const& eight, int i) {
  auto const vector = [&](std::array<Lanes, 3> const& v) { return Real3{v[0][i], v[1][i], v[2][i]}; };
  return {eight.weight[i],      eight.kinetic_energy[i], vector(eight.momentum), vector(eight.mean_x),
          vector(eight.mean_u), vector(eight.xx),        vector(eight.uu),       vector(eight.xu)};
}

/// Those of this rank's particles.
BeamSums<Real> local_sums(ParticleView const& particles, Real const* mass, bool same, std::array<Real*, 3> const& later,
                          Real share) {
  constexpr Real c = speed_of_light;
  BeamSums<Lanes> eight;
  for (std::int64_t first = 0; first < particles.count; first += lane_count) {
    std::int64_t const left = particles.count - first;
    LaneGroup const group{first, left < lane_count ? (1u << left) - 1 : all_lanes};
    Lanes weight = load(particles.weight, particles.equal_weights, group);
    if (!group.whole()) weight = select(mask_of(group.lanes), weight, Lanes{});
    Lanes const m = load(mass, same, group), per_mc = 1 / (m * c);
    std::array<Lanes, 3> x, u;
    Lanes square{};
    for (std::size_t d = 0; d < 3; ++d) {
      Lanes const early = load(particles.momentum[d], group), p = early + share * (load(later[d], group) - early);
      x[d] = load(particles.position[d], group);
      u[d] = p * per_mc;
      square += u[d] * u[d];
      eight.momentum[d] += weight * p;
    }
    // u² / (gamma + 1) equals gamma - 1 and loses no digits when particles are slow.
    eight.kinetic_energy += weight * (m * (c * c)) * (square / (square_root(1 + square) + 1));
    eight.add(weight, x, u);
  }
  BeamSums<Real> out;
  for (int i = 0; i < lane_count; ++i) out.add(part(eight, i));
  return out;
}

}  // namespace

BeamSums<Real> beam_sums(Communicator const& comm, ParticleView const& particles, Real const* mass, bool same,
                         std::array<Real*, 3> const& later, Real share) {
  BeamSums<Real> out;
  std::vector const own{local_sums(particles, mass, same, later, share)};
  for (auto const& of_rank : comm.gather(own).values) out.add(of_rank);
  return out;
}

}  // namespace amrpic
