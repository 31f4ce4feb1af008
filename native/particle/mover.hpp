// How particles move by fields: one by one, or eight at a time.
#pragma once

#include "particle/motion.hpp"
#include "particle/push.hpp"

namespace amrpic {

/// A particle by itself, where a kernel takes no group of them.
struct Single {
  std::int64_t n;
};
KOKKOS_INLINE_FUNCTION Real load(Real const* values, Single at) { return values[at.n]; }
KOKKOS_INLINE_FUNCTION Real load(Real const* values, bool one, Single at) { return values[one ? 0 : at.n]; }
KOKKOS_INLINE_FUNCTION void store(Real* values, Single at, Real value, bool) { values[at.n] = value; }

/// The columns of a group, or of one particle.
template <class At>
KOKKOS_INLINE_FUNCTION auto load_columns(std::array<Real*, 3> const& columns, At const& at) {
  return Vector3<decltype(load(columns[0], at))>{load(columns[0], at), load(columns[1], at), load(columns[2], at)};
}

template <class V>
KOKKOS_INLINE_FUNCTION void add(Vector3<V>& to, Vector3<V> const& more) {
  for (std::size_t d = 0; d < 3; ++d) to[d] += more[d];
}

/// Particles in fields.
template <class V>
struct InFields {
  Vector3<V> x, p;
  V charge, inverse_mass, per_mc;

  KOKKOS_INLINE_FUNCTION Vector3<V> velocity() const { return scaled(inverse_mass * inverse_gamma(p, per_mc), p); }
  KOKKOS_INLINE_FUNCTION void kick(Vector3<V> const& e, Real time) {
    V const impulse = charge * time;
    for (std::size_t d = 0; d < 3; ++d) p[d] += impulse * e[d];
  }
  KOKKOS_INLINE_FUNCTION void turn(Pusher pusher, Vector3<V> const& b, V const& time) {
    p = turned(pusher, p, b, 0.5 * time * charge * inverse_mass, per_mc);
  }
  /// Half of the kick by E, the turn by B, and the other half: where E + v x B = 0, momenta stay what they are.
  KOKKOS_INLINE_FUNCTION void act(Pusher pusher, Vector3<V> const& e, Vector3<V> const& b, Real time) {
    kick(e, 0.5 * time);
    turn(pusher, b, time + V{});
    kick(e, 0.5 * time);
  }
};

/// What becomes of particles in a step.
template <class V>
struct Moving {
  Vector3<V> between, p, x;
};

/// Moves particles that feel a field of the mesh, a group or one at a time.
struct Mover {
  ParticleView particles;
  Motion motion;
  Moved out;
  bool far;  ///< whether what is written is not wanted soon
  bool has_own_b = motion.beta != Real3{};
  Real3 beta_per_c{motion.beta[0] / speed_of_light, motion.beta[1] / speed_of_light, motion.beta[2] / speed_of_light};

  /// Whether there are fields beside that of the mesh.
  bool has_more() const { return has_own_b || motion.added.electric[0] || motion.added.magnetic[0]; }

  template <class At>
  KOKKOS_INLINE_FUNCTION auto load_group(At const& at) const {
    auto const inverse_mass = load(motion.inverse_mass, motion.same, at);
    return InFields<std::decay_t<decltype(inverse_mass)>>{
        load_columns(particles.position, at), load_columns(particles.momentum, at),
        load(motion.charge, motion.same, at), inverse_mass, inverse_mass * (1 / speed_of_light)};
  }
  template <class V>
  KOKKOS_INLINE_FUNCTION Vector3<V> flown(InFields<V> const& on) const {
    V const drift = motion.flight * on.inverse_mass * inverse_gamma(on.p, on.per_mc);
    Vector3<V> out;
    for (std::size_t d = 0; d < 3; ++d) out[d] = on.x[d] + (drift * on.p[d] - motion.shift[d]);
    return out;
  }
  template <class At, class V>
  KOKKOS_INLINE_FUNCTION void write(At const& at, Moving<V> const& moved) const {
    for (std::size_t d = 0; d < 3; ++d) {
      if (out.between[0]) store(out.between[d], at, moved.between[d], far);
      store(out.momentum[d], at, moved.p[d], far);
      store(out.position[d], at, moved.x[d], far);
    }
  }
  /// By the field of the mesh alone.
  template <class At, class V>
  KOKKOS_INLINE_FUNCTION void by_mesh(At const& at, Vector3<V> const& felt) const {
    auto on = load_group(at);
    on.kick(felt, motion.before);
    Vector3<V> const between = on.p;
    on.kick(felt, motion.after);
    write(at, Moving<V>{between, on.p, flown(on)});
  }

  /// The fields of charge that moves with beta, and those that are added.
  template <class At, class V>
  KOKKOS_INLINE_FUNCTION std::array<Vector3<V>, 2> fields(At const& at, Vector3<V> const& felt) const {
    std::array<Vector3<V>, 2> fields{felt, {}};
    if (has_own_b) fields[1] = cross(beta_per_c, felt);
    if (motion.added.electric[0]) add(fields[0], load_columns(motion.added.electric, at));
    if (motion.added.magnetic[0]) add(fields[1], load_columns(motion.added.magnetic, at));
    return fields;
  }
  /// By all fields at places.
  template <class At, class V>
  KOKKOS_INLINE_FUNCTION void by_fields(At const& at, Vector3<V> const& felt) const {
    auto const both = fields(at, felt);
    write(at, moved(load_group(at), both[0], both[1]));
  }
  template <class V>
  KOKKOS_INLINE_FUNCTION Moving<V> moved(InFields<V> on, Vector3<V> const& e, Vector3<V> const& b) const {
    on.act(motion.pusher, e, b, motion.before);
    Vector3<V> const between = on.p;
    on.act(motion.pusher, e, b, motion.after);
    return {between, on.p, flown(on)};
  }
};

}  // namespace amrpic
