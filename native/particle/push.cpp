#include "particle/push.hpp"

#include <algorithm>

#include "particle/mover.hpp"
#include "particle/read_field.hpp"

namespace amrpic {

namespace {

using Group = InFields<Lanes>;

inline Lanes or_one(Lanes const& divisor) { return select(divisor == 0, 1 + Lanes{}, divisor); }

/// The passage of a plane with this unit normal and a mean B there over `time`, `when` (s) from now, for what arrived
/// with velocity `v`.
///
/// Along the normal dp/dn = q v × B / v_n: B along it turns p about it, and B in the plane gives the impulse
/// q v_n n × B, which does not depend on how p changes meanwhile; |p| stays. A solenoid's edge so keeps the canonical
/// angular momentum. The place is shifted so that the change counts from the plane on.
inline void pass(Group& on, Pusher pusher, Components const& b, Components const& normal, Components const& v,
                 Real time, Lanes const& when) {
  Components const before = on.p;
  Lanes const way = time * dot(v, normal), now = dot(on.velocity(), normal), slower = way / or_one(now);
  Lanes const along = dot(b, normal);
  on.turn(pusher, scaled(along, normal), select(slower < 0, 0 - slower, slower));
  Components const impulse = scaled(on.charge * way, cross(normal, b));
  Lanes const gained = 2 * dot(on.p, impulse) + dot(impulse, impulse), p_n = dot(on.p, normal);
  Lanes const left = 1 - gained / or_one(p_n * p_n);
  Lanes const change = select(gained == 0, Lanes{}, p_n * (square_root(select(left < 0, Lanes{}, left)) - 1));
  for (int d = 0; d < 3; ++d) on.p[d] += impulse[d] + change * normal[d];
  Lanes const shift = when * on.inverse_mass * inverse_gamma(on.p, on.per_mc);
  for (int d = 0; d < 3; ++d) on.x[d] = on.x[d] - shift * (on.p[d] - before[d]);
}

/// Shift places so that changes of velocity in fields that end on the way count from their own times on.
inline void shift_by_moments(Group& on, Edges<Lanes> const& edges) {
  Components const v = on.velocity(), turn = cross(v, edges.magnetic_moment);
  Components force;
  for (int d = 0; d < 3; ++d) force[d] = edges.electric_moment[d] + turn[d];
  Lanes const power = dot(v, force) * (1 / (speed_of_light * speed_of_light));
  Lanes const by = on.charge * on.inverse_mass * inverse_gamma(on.p, on.per_mc);
  for (int d = 0; d < 3; ++d) on.x[d] = on.x[d] - by * (force[d] - power * v[d]);
}

/// One of the parts, in fields of elements that may end on the way. What these have in the planes where they begin and
/// end acts first and last.
inline void act_along_flight(Group& on, Components e, Components b, Real time, bool is_before, Motion const& motion) {
  if (!(time > 0)) return;
  Edges<Lanes> edges;
  Components const arriving = on.velocity();
  Real const from = is_before ? -time : 0, to = is_before ? 0 : time;
  add_mean_field(*motion.external, Flight<Lanes>{on.x, arriving, motion.time, from, to}, e, b, edges);
  if (edges.crossed) pass(on, motion.pusher, edges.first, edges.normal, arriving, time, edges.entered);
  on.act(motion.pusher, e, b, time);
  if (edges.crossed) pass(on, motion.pusher, edges.last, edges.normal, arriving, time, edges.left);
  shift_by_moments(on, edges);
}

/// Both of them. Return the momenta between.
inline Components act_along_flights(Group& on, Components const& e, Components const& b, Motion const& motion) {
  act_along_flight(on, e, b, motion.before, true, motion);
  Components const between = on.p;
  act_along_flight(on, e, b, motion.after, false, motion);
  return between;
}

inline Real reach_of(Motion const& motion) { return speed_of_light * std::max(motion.before, motion.after); }

/// Those of `yes` where `which` is positive, else those of `no`.
inline Components where(Lanes const& which, Components const& yes, Components const& no) {
  Components out;
  for (int d = 0; d < 3; ++d) out[d] = select(which > 0, yes[d], no[d]);
  return out;
}

/// What a mover finds, with those particles of a group that are near the end of a field moved along their flights.
[[gnu::noinline]] Moving<Lanes> along_flights(Mover const& mover, LaneGroup const& group, Components const& felt,
                                              Lanes const& near, Moving<Lanes> const& others) {
  if (bits_of(near > 0) == 0) return others;
  auto const [e, b] = mover.fields(group, felt);
  Group on = mover.load_group(group);
  Components const between = act_along_flights(on, e, b, mover.motion);
  return {where(near, between, others.between), where(near, on.p, others.p), where(near, mover.flown(on), others.x)};
}

/// Moves the particles of a block by all fields, of elements too: these are found for the block first.
class BlockMover {
 public:
  BlockMover(Mover const& mover, LaneBlock const& block) : mover_(mover), block_(block) {
    for_each_group(block, [&](LaneGroup const& group) {
      at_.x[at_.count] = load_columns(mover.particles.position, group);
      at_.E[at_.count] = at_.B[at_.count] = {};
      place_[number_in_block(block, group)] = at_.count++;
    });
    near_ = mover.motion.external->add_field(mover.motion.time, reach_of(mover.motion), at_);
  }
  void operator()(LaneGroup const& group, Components const& felt) const {
    std::size_t const n = place_[number_in_block(block_, group)];
    auto [e, b] = mover_.fields(group, felt);
    add(e, at_.E[n]);
    add(b, at_.B[n]);
    Moving<Lanes> moved = mover_.moved(mover_.load_group(group), e, b);
    if (near_) moved = along_flights(mover_, group, felt, at_.near_end[n], moved);
    mover_.write(group, moved);
  }

 private:
  Mover const& mover_;
  LaneBlock const& block_;
  external::Places at_;
  std::array<std::size_t, external::Places::most> place_;
  bool near_;
};

}  // namespace

void push(ParticleMesh& mesh, RemoteBricks const& remote, Clouds const& clouds, ElectricField const& field,
          ParticleView const& particles, std::int64_t const* starts, Motion const& motion, Moved const& out) {
  auto const p = out.momentum, x = out.position, between = out.between;
  bool const far = are_far(particles.count, p[0], p[1], p[2], x[0], x[1], x[2], between[0], between[1], between[2]);
  Mover const mover{particles, motion, out, far};
  auto const move = [&](auto const& use) { read_field(mesh, remote, clouds, field, particles, starts, use); };
  if (motion.external && !motion.external->empty())
    move([&](LaneBlock const& block) { return BlockMover(mover, block); });
  else if (clouds.kernels)
    read_tiles(mesh, remote, clouds.matched, field, particles, starts,
               PortableReader(mesh, *clouds.kernels, particles, [&](TileKernels const& kernels, auto const& tiles) {
                 return kernels.push(clouds.shape, particles, tiles, mover);
               }));
  else if (mover.has_more())
    move([=](LaneGroup const& group, Components const& felt) { mover.by_fields(group, felt); });
  else
    move([=](LaneGroup const& group, Components const& felt) { mover.by_mesh(group, felt); });
  stream_end();
}

OneParticle push_one(OneParticle const& particle, Motion const& motion) {
  Lanes const inverse_mass = particle.inverse_mass + Lanes{};
  Group on{{}, {}, particle.charge + Lanes{}, inverse_mass, inverse_mass * (1 / speed_of_light)};
  for (std::size_t d = 0; d < 3; ++d) {
    on.x[d] = particle.position[d] + Lanes{};
    on.p[d] = particle.momentum[d] + Lanes{};
  }
  external::Places at;
  at.count = 1;
  at.x[0] = on.x;
  at.E[0] = at.B[0] = {};
  if (motion.external->add_field(motion.time, reach_of(motion), at))
    act_along_flights(on, {}, {}, motion);
  else
    for (Real const time : {motion.before, motion.after}) on.act(motion.pusher, at.E[0], at.B[0], time);
  Components const v = on.velocity();
  OneParticle out = particle;
  for (std::size_t d = 0; d < 3; ++d) {
    out.momentum[d] = on.p[d][0];
    out.position[d] = (on.x[d] + motion.flight * v[d])[0];
  }
  return out;
}

}  // namespace amrpic
