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
BeamSums<Real> local_sums(BeamView const& beam, NearestImages const& images) {
  std::int64_t const count = beam.particles.count;
  BeamSums<Lanes> eight;
  for (std::int64_t first = 0; first < count; first += lane_count) {
    std::int64_t const left = count - first;
    LaneGroup const group{first, left < lane_count ? (1u << left) - 1 : all_lanes};
    BeamLanes of = load(beam, group);
    for (std::size_t d = 0; d < 3; ++d) of.x[d] = images.along(d, of.x[d]);
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

/// sin(2π turns): a parabola in each half turn, and a share of its square.
Lanes sine_of_turns(Lanes const& turns) {
  Lanes const t = turns - round_down(turns + Real(0.5));
  Lanes const half = 8 * t * (1 - 2 * select(t < Lanes{}, 0 - t, t));
  return half * (Real(0.775) + Real(0.225) * select(half < Lanes{}, 0 - half, half));
}

}  // namespace

std::vector<std::array<Real, 8>> circular_sums(Communicator const& comm, BeamView const& beam, BeamParts const& parts,
                                               Real3 const& lower, Real3 const& period) {
  std::vector<std::array<Real, 8>> out(parts.count());
  Real const quarter_turn = Real(1) / 4;
  auto const of_eight = [&](BeamLanes const& of) {
    std::array<Lanes, 8> values{of.weight, of.weight * of.weight};
    for (std::size_t d = 0; d < 3; ++d) {
      if (period[d] == 0) continue;
      Lanes const turns = (of.x[d] - lower[d]) * (1 / period[d]);
      values[2 + 2 * d] = of.weight * sine_of_turns(turns + quarter_turn);
      values[3 + 2 * d] = of.weight * sine_of_turns(turns);
    }
    return values;
  };
  for_each_of_parts(
      beam, parts,
      [&](std::size_t part, BeamLanes const& eight) {
        auto const values = of_eight(eight);
        for (std::size_t n = 0; n < 8; ++n)
          for (int i = 0; i < lane_count; ++i) out[part][n] += values[n][i];
      },
      [&](std::size_t part, BeamLanes const& eight, int lane) {
        auto const values = of_eight(eight);
        for (std::size_t n = 0; n < 8; ++n) out[part][n] += values[n][lane];
      });
  std::vector<Real> flat;
  for (auto const& sums : out) flat.insert(flat.end(), sums.begin(), sums.end());
  comm.sum_each(flat);
  for (std::size_t n = 0; n < flat.size(); ++n) out[n / 8][n % 8] = flat[n];
  return out;
}

BeamSums<Real> beam_sums(Communicator const& comm, BeamView const& beam, NearestImages const& images) {
  std::vector sums{local_sums(beam, images)};
  comm.add_each(sums);
  return sums[0];
}

}  // namespace amrpic
