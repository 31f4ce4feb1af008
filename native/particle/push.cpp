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

/// B of charge that moves with `beta`, from its electric field.
inline Components self_magnetic_field(Real3 const& beta, Components const& e) {
  return cross(Real3{beta[0] / speed_of_light, beta[1] / speed_of_light, beta[2] / speed_of_light}, e);
}

/// Eight particles in fields.
struct Group {
  Components x, p;
  Lanes charge, inverse_mass, per_mc;

  Components velocity() const {
    Lanes const over = inverse_mass * inverse_gamma(p, per_mc);
    return {over * p[0], over * p[1], over * p[2]};
  }
  void kick(Components const& e, Real time) {
    Lanes const impulse = charge * time;
    for (int d = 0; d < 3; ++d) p[d] += impulse * e[d];
  }
  void turn(Pusher pusher, Components const& b, Lanes const& time) {
    p = turned(pusher, p, b, time * charge * inverse_mass, per_mc);
  }
  /// The passage of a plane with this unit normal and a mean B there over `time`, `when` (s) from now, for what arrived
  /// with velocity `v`.
  ///
  /// Along the normal dp/dn = q v × B / v_n: B along it turns p about it, and B in the plane gives the impulse
  /// q v_n n × B, which does not depend on how p changes meanwhile; |p| stays. A solenoid's edge so keeps the canonical
  /// angular momentum. The place is shifted so that the change counts from the plane on.
  void pass(Pusher pusher, Components const& b, Components const& normal, Components const& v, Real time,
            Lanes const& when) {
    Components const before = p;
    Lanes const way = time * dot(v, normal), now = dot(velocity(), normal), slower = way / or_one(now);
    Lanes const along = dot(b, normal);
    turn(pusher, scaled(along, normal), select(slower < 0, 0 - slower, slower));
    Components const impulse = scaled(charge * way, cross(normal, b));
    Lanes const gained = 2 * dot(p, impulse) + dot(impulse, impulse), p_n = dot(p, normal);
    Lanes const left = 1 - gained / or_one(p_n * p_n);
    Lanes const change = select(gained == 0, Lanes{}, p_n * (square_root(select(left < 0, Lanes{}, left)) - 1));
    for (int d = 0; d < 3; ++d) p[d] += impulse[d] + change * normal[d];
    Lanes const shift = when * inverse_mass * inverse_gamma(p, per_mc);
    for (int d = 0; d < 3; ++d) x[d] = x[d] - shift * (p[d] - before[d]);
  }
  static Lanes or_one(Lanes const& divisor) { return select(divisor == 0, 1 + Lanes{}, divisor); }
};

/// A part of a step: a kick by E and a turn by B before the positions' time, a turn and a kick after it. What elements
/// have in the planes where they begin and end acts first and last.
inline void act(Group& on, Components e, Components b, bool has_b, Real time, bool is_before, Motion const& motion) {
  Edges<Lanes> edges;
  Components arriving;
  if (motion.external && time > 0) {
    arriving = on.velocity();
    Real const from = is_before ? -time : 0, to = is_before ? 0 : time;
    add_mean_field(*motion.external, Flight<Lanes>{on.x, arriving, motion.time, from, to}, e, b, edges);
  }
  if (edges.crossed) on.pass(motion.pusher, edges.first, edges.normal, arriving, time, edges.entered);
  if (is_before) on.kick(e, time);
  if (has_b) on.turn(motion.pusher, b, time + Lanes{});
  if (!is_before) on.kick(e, time);
  if (edges.crossed) on.pass(motion.pusher, edges.last, edges.normal, arriving, time, edges.left);
}

}  // namespace

void push(ParticleMesh& mesh, Clouds const& clouds, ElectricField const& field, ParticleView const& particles,
          std::int64_t const* starts, Motion const& motion, Moved const& out) {
  auto const p = out.momentum, x = out.position, between = out.between;
  bool const far = are_far(particles.count, p[0], p[1], p[2], x[0], x[1], x[2], between[0], between[1], between[2]);
  AddedFields const& added = motion.added;
  bool const has_self_b = motion.beta != Real3{},
             has_b = has_self_b || added.magnetic[0] || (motion.external && motion.external->magnetic());
  read_field(mesh, clouds, field, particles, starts, [=](LaneGroup const& group, Components const& felt) {
    Lanes const inverse_mass = load(motion.inverse_mass, motion.same, group);
    Group on{load_columns(particles.position, group), load_columns(particles.momentum, group),
             load(motion.charge, motion.same, group), inverse_mass, inverse_mass * (1 / speed_of_light)};
    Components e = felt, b{};
    if (added.electric[0]) add(e, load_columns(added.electric, group));
    if (has_self_b) b = self_magnetic_field(motion.beta, felt);
    if (added.magnetic[0]) add(b, load_columns(added.magnetic, group));

    act(on, e, b, has_b, motion.before, true, motion);
    for (int d = 0; d < 3 && between[0]; ++d) store(between[d], group, on.p[d], far);
    act(on, e, b, has_b, motion.after, false, motion);
    Lanes const time_over_mass = motion.flight * on.inverse_mass * inverse_gamma(on.p, on.per_mc);
    for (int d = 0; d < 3; ++d) {
      store(p[d], group, on.p[d], far);
      store(x[d], group, on.x[d] + (time_over_mass * on.p[d] - motion.shift[std::size_t(d)]), far);
    }
  });
  stream_end();
}

OneParticle push_one(OneParticle const& particle, Motion const& motion) {
  Lanes const inverse_mass = particle.inverse_mass + Lanes{};
  Group on{{}, {}, particle.charge + Lanes{}, inverse_mass, inverse_mass * (1 / speed_of_light)};
  for (std::size_t d = 0; d < 3; ++d) {
    on.x[d] = particle.position[d] + Lanes{};
    on.p[d] = particle.momentum[d] + Lanes{};
  }
  bool const has_b = motion.external && motion.external->magnetic();
  act(on, {}, {}, has_b, motion.before, true, motion);
  act(on, {}, {}, has_b, motion.after, false, motion);
  Components const v = on.velocity();
  OneParticle out = particle;
  for (std::size_t d = 0; d < 3; ++d) {
    out.momentum[d] = on.p[d][0];
    out.position[d] = (on.x[d] + motion.flight * v[d])[0];
  }
  return out;
}

}  // namespace amrpic
