#include "particle/push.hpp"

#include "base/lanes.hpp"
#include "particle/read_field.hpp"

namespace amrpic {

namespace {

/// The columns of a group.
inline Components load_columns(std::array<Real*, 3> const& columns, LaneGroup const& group) {
  return {load(columns[0], group), load(columns[1], group), load(columns[2], group)};
}

inline void add(Components& to, Components const& more) {
  for (int d = 0; d < 3; ++d) to[d] += more[d];
}

inline Components kicked(Components p, Lanes const& charge_time, Components const& e) {
  for (int d = 0; d < 3; ++d) p[d] += charge_time * e[d];
  return p;
}

/// B of charge that moves with `beta`, from its electric field.
inline Components self_magnetic_field(Real3 const& beta, Components const& e) {
  Real3 const b{beta[0] / speed_of_light, beta[1] / speed_of_light, beta[2] / speed_of_light};
  return {b[1] * e[2] - b[2] * e[1], b[2] * e[0] - b[0] * e[2], b[0] * e[1] - b[1] * e[0]};
}

}  // namespace

void push(ParticleMesh& mesh, Clouds const& clouds, ElectricField const& field, ParticleView const& particles,
          std::int64_t const* starts, Motion const& motion, Moved const& out) {
  auto const p = out.momentum, x = out.position, between = out.between;
  bool const far = are_far(particles.count, p[0], p[1], p[2], x[0], x[1], x[2], between[0], between[1], between[2]);
  AddedFields const& added = motion.added;
  bool const has_self_b = motion.beta != Real3{}, has_b = has_self_b || added.magnetic[0];
  read_field(mesh, clouds, field, particles, starts, [=](LaneGroup const& group, Components const& felt) {
    Lanes const charge = load(motion.charge, motion.same, group);
    Lanes const inverse_mass = load(motion.inverse_mass, motion.same, group);
    Lanes const per_mc = inverse_mass * (1 / speed_of_light);
    Lanes const before = motion.before * charge, after = motion.after * charge;
    Components e = felt, momentum = load_columns(particles.momentum, group);
    if (added.electric[0]) add(e, load_columns(added.electric, group));
    Components b{};
    if (has_self_b) b = self_magnetic_field(motion.beta, felt);
    if (added.magnetic[0]) add(b, load_columns(added.magnetic, group));

    momentum = kicked(momentum, before, e);
    if (has_b) momentum = turned(motion.pusher, momentum, b, before * inverse_mass, per_mc);
    for (int d = 0; d < 3 && between[0]; ++d) store(between[d], group, momentum[d], far);
    if (has_b) momentum = turned(motion.pusher, momentum, b, after * inverse_mass, per_mc);
    momentum = kicked(momentum, after, e);
    Lanes const time_over_mass = motion.flight * inverse_mass / lorentz_factor(momentum, per_mc);
    for (int d = 0; d < 3; ++d) {
      store(p[d], group, momentum[d], far);
      store(x[d], group, load(particles.position[d], group) + time_over_mass * momentum[d], far);
    }
  });
  stream_end();
}

}  // namespace amrpic
