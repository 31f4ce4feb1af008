#include "particle/push.hpp"

#include "particle/lanes.hpp"

namespace amrpic {

void drift(ParticleView const& particles, Real const* time_over_mass, bool same, std::array<Real*, 3> const& out) {
  bool const far = are_far(particles.count, out[0], out[1], out[2]);
  for_each_group(0, particles.count, [&](LaneGroup const& group) {
    Lanes const factor = same ? time_over_mass[0] + Lanes{} : load(time_over_mass, group);
    for (int d = 0; d < 3; ++d)
      store(out[d], group, factor * load(particles.momentum[d], group) + load(particles.position[d], group), far);
  });
  stream_end();
}

}  // namespace amrpic
