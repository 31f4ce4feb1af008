#include "particle/moments.hpp"

#include "base/communicator.hpp"

namespace amrpic {

namespace {

/// Part i of eight.
BeamSums<Real> part(BeamSums<Lanes> const& eight, int i) {
  auto const vector = [&](std::array<Lanes, 3> const& v) { return Real3{v[0][i], v[1][i], v[2][i]}; };
  return {eight.weight[i],      eight.kinetic_energy[i], vector(eight.momentum), vector(eight.mean_x),
          vector(eight.mean_u), vector(eight.xx),        vector(eight.uu),       vector(eight.xu)};
}

/// Those of this rank's particles.
BeamSums<Real> local_sums(BeamView const& beam) {
  std::int64_t const count = beam.particles.count;
  BeamSums<Lanes> eight;
  for (std::int64_t first = 0; first < count; first += lane_count) {
    std::int64_t const left = count - first;
    LaneGroup const group{first, left < lane_count ? (1u << left) - 1 : all_lanes};
    BeamLanes const of = load(beam, group);
    Lanes const weight = group.whole() ? of.weight : select(mask_of(group.lanes), of.weight, Lanes{});
    Lanes const weighted_mc = weight * of.mass * speed_of_light;
    for (std::size_t d = 0; d < 3; ++d) eight.momentum[d] += weighted_mc * of.u[d];
    eight.kinetic_energy += weight * kinetic_energy(of);
    eight.add(weight, of.x, of.u);
  }
  BeamSums<Real> out;
  for (int i = 0; i < lane_count; ++i) out.add(part(eight, i));
  return out;
}

}  // namespace

BeamSums<Real> beam_sums(Communicator const& comm, BeamView const& beam) {
  std::vector sums{local_sums(beam)};
  comm.add_each(sums);
  return sums[0];
}

}  // namespace amrpic
