#include "particle/classify.hpp"

#include <algorithm>
#include <deque>

#include "base/fetch.hpp"
#include "particle/home_box.hpp"
#include "particle/lane_groups.hpp"

namespace amrpic {

namespace {

/// Particles that were sorted before they moved mostly lie in the brick of their neighbour in memory. So eight at a
/// time are compared with the current brick, and only those that left it are looked up.
class Classifier {
 public:
  Classifier(ParticleMesh& mesh, Servers const& servers, ParticleView const& particles, ParticleList const& gone)
      : mesh_(mesh),
        servers_(servers),
        particles_(particles),
        next_gone_(gone.first),
        end_of_gone_(gone.last),
        out_(mesh) {
    out_.stays = Scratch<std::uint8_t>(std::size_t(particles.count) / lane_count + 1);
    out_.leavers.resize(std::size_t(mesh.hierarchy().comm().ranks()));
    out_.per_brick.assign(std::size_t(mesh.bricks()), 0);
    neighbours_.fill(-1);
    if (!alone()) parts_.assign(std::size_t(mesh.bricks()), not_found);
  }

  Destinations classify() &&;

 private:
  using Part = Servers::Part;
  /// A brick of a box of this rank, or, in slots behind these, a remote brick; none if negative.
  struct LocalBrick {
    int slot = -1, brick = -1;
  };

  LaneGroup remaining(LaneGroup const& group);
  void compare(LaneGroup const& group);
  unsigned outside(HomeBrick const& brick, LocalBrick const& at, LaneGroup const& group) const;
  void find_leavers();
  unsigned begin_run(LaneGroup const& group, unsigned out);
  void end_run(LocalIndex last);
  LocalBrick find(Real3 const& x);
  LocalBrick find_in_neighbours(Real3 const& x) const;
  LocalBrick local(Home const& home);
  void look_up(LocalIndex n);
  void move_to(LocalIndex brick, LocalIndex n, std::vector<Destinations::Mover>& movers);
  HomeBox const& box(int slot) const {
    return slot < own_slots() ? mesh_.homes()[std::size_t(slot)] : remote_[std::size_t(slot - own_slots())];
  }
  HomeBox const& current_box() const { return box(current_.slot); }
  int own_slots() const { return int(mesh_.boxes().size()); }
  LocalIndex number(LocalBrick const& at) const {
    return at.slot < own_slots() ? mesh_.first_brick(at.slot) + at.brick : mesh_.bricks() + at.slot - own_slots();
  }
  /// Which of its particles this rank serves.
  Part part(LocalBrick const& at) const {
    if (alone()) return Part::all;
    signed char& found = parts_[std::size_t(number(at))];
    if (found == not_found) found = static_cast<signed char>(part_of(home(at)));
    return Part(found);
  }
  Part part_of(Home const& home) const {
    if (servers_.are_owners()) return out_.bricks.is_own(home) ? Part::all : Part::none;
    return servers_.part(place(home));
  }
  int server_of(Home const& home, LocalIndex n) const {
    if (servers_.are_owners()) return mesh_.hierarchy().level(home.level).owner(home.box);
    return servers_.server(place(home) + BrickCurve::hash(particles_.id[n]));
  }
  bool alone() const { return mesh_.hierarchy().comm().ranks() == 1; }
  std::int64_t place(Home const& home) const {
    Box const& box = mesh_.hierarchy().level(home.level).box(home.box);
    return servers_.curve().place(home.level, Bricks(box)[home.brick].lower);
  }
  Home home(LocalBrick const& at) const {
    if (at.slot >= own_slots()) return out_.bricks.remote()[std::size_t(at.slot - own_slots())];
    BoxGhosts const& box = mesh_.boxes()[std::size_t(at.slot)];
    return {box.level, box.box, at.brick};
  }
  bool serves(LocalBrick const& at, LocalIndex n) const {
    Part const of_brick = part(at);
    return of_brick == Part::all ||
           (of_brick == Part::some && servers_.serves(place(home(at)) + BrickCurve::hash(particles_.id[n])));
  }

  ParticleMesh& mesh_;
  Servers const& servers_;
  ParticleView const& particles_;
  std::int64_t const *next_gone_, *end_of_gone_;
  Destinations out_;
  static constexpr signed char not_found = -1;
  mutable std::vector<signed char> parts_;  ///< of each brick, by number
  std::deque<HomeBox> remote_;              ///< remote bricks, in the order of their numbers
  LocalBrick current_;
  HomeBrick current_brick_{};       ///< at first one that contains nothing
  Destinations::Run run_{};         ///< of the current brick
  std::array<int, 27> neighbours_;  ///< slots found next to its box, by direction; -1: none yet
  /// Particles that left the current brick: looked up a few dozen at a time, so that the processor need not guess after
  /// each eight which these are.
  LocalIndex left_[block_size] = {};
  int left_count_ = 0;
  Home latest_;  ///< of the particle that was looked up last
};

Destinations Classifier::classify() && {
  LocalIndex const count = LocalIndex(particles_.count), whole = count / lane_count * lane_count;
  for (LocalIndex n = 0; n < whole; n += lane_count) {
    for (int d = 0; d < 3; ++d) bring_near(particles_.position[d] + n + page<Real>);
    compare(remaining({n, all_lanes}));
  }
  if (whole < count) compare(remaining({whole, all_lanes >> (lane_count - (count - whole))}));
  find_leavers();
  end_run(count);
  return std::move(out_);
}

/// Those of a group that are not gone.
inline LaneGroup Classifier::remaining(LaneGroup const& group) {
  LaneGroup out = group;
  for (; next_gone_ != end_of_gone_ && *next_gone_ < group.first + lane_count; ++next_gone_)
    out.lanes &= ~(1u << (*next_gone_ - group.first));
  return out;
}

/// Compare a group with the current brick, or with that of its last particle.
inline void Classifier::compare(LaneGroup const& group) {
  if (group.lanes == 0) {
    out_.stays[std::size_t(group.first / lane_count)] = 0;
    return;
  }
  unsigned out = outside(current_brick_, current_, group);
  if (2 * __builtin_popcount(out) > __builtin_popcount(group.lanes)) {
    find_leavers();
    out = begin_run(group, out);
  }
  LocalIndex const n = LocalIndex(group.first);
  out_.stays[std::size_t(n / lane_count)] = std::uint8_t(group.lanes & ~out);
  run_.stayed += __builtin_popcount(group.lanes & ~out);
  left_count_ += compress(out, n + index_of_lane, left_ + left_count_);
  if (left_count_ > block_size - lane_count) find_leavers();
}

/// A bit for each particle of a group that lies outside a brick, or that this rank does not serve there.
inline unsigned Classifier::outside(HomeBrick const& brick, LocalBrick const& at, LaneGroup const& group) const {
  std::array<Lanes, 3> x;
  for (int d = 0; d < 3; ++d) x[d] = load(particles_.position[d], group);
  unsigned const inside = bits_of(brick.contains(x)) & group.lanes;
  unsigned out = group.lanes & ~inside;
  if (at.slot >= 0 && part(at) != Part::all)
    for (int i = 0; i < lane_count; ++i)
      if ((inside >> i & 1) && !serves(at, LocalIndex(group.first + i))) out |= 1u << i;
  return out;
}

/// Find where the particles are that left the current brick: mostly in its box, else mostly in one next to it.
void Classifier::find_leavers() {
  auto const& at = particles_.position;
  for (int first = 0; first < left_count_; first += lane_count) {
    LocalIndex const* const n = left_ + first;
    IndexLanes brick = IndexLanes{} - 1;
    if (current_.slot >= 0) brick = current_box().find({pick(at[0], n), pick(at[1], n), pick(at[2], n)});
    for (int i = 0; i < std::min(lane_count, left_count_ - first); ++i)
      if (LocalBrick const at{current_.slot, brick[i]}; at.brick >= 0 && serves(at, n[i]))
        move_to(number(at), n[i], out_.movers);
      else if (LocalBrick const next = find_in_neighbours(particles_.at(n[i])); next.brick >= 0 && serves(next, n[i]))
        move_to(number(next), n[i], out_.movers);
      else
        look_up(n[i]);
  }
  left_count_ = 0;
}

/// Make the brick of a group's last particle the current one if it contains more of the group than the current one,
/// outside which `out` lie. Return which lie outside the brick that is current now.
unsigned Classifier::begin_run(LaneGroup const& group, unsigned out) {
  Real3 const x = particles_.at(group.first + group.last());
  LocalBrick at;
  if (current_.slot >= 0) at = {current_.slot, current_box().find(x)};
  if (at.brick < 0) at = find_in_neighbours(x);
  if (at.brick < 0) at = find(x);
  if (at.brick < 0 || part(at) == Part::none) return out;
  HomeBrick const next = box(at.slot).brick(at.brick);
  unsigned const out_of_next = outside(next, at, group);
  if (__builtin_popcount(out_of_next) >= __builtin_popcount(out)) return out;
  LocalIndex const n = LocalIndex(group.first);
  end_run(n);
  if (at.slot != current_.slot) neighbours_.fill(-1);
  current_ = at;
  current_brick_ = next;
  run_ = {number(at), n, n, 0};
  return out_of_next;
}

void Classifier::end_run(LocalIndex last) {
  run_.last = last;
  if (run_.stayed == 0) return;
  out_.runs.push_back(run_);
  out_.per_brick[std::size_t(run_.brick)] += run_.stayed;
}

/// Where x lies, if that is in a brick that this rank serves, and no finer box may contain it.
Classifier::LocalBrick Classifier::find(Real3 const& x) {
  Real3 wrapped = x;
  if (!is_finite(x) || !mesh_.locator().wrap(wrapped) || wrapped != x) return {};
  LocalBrick const at = local(mesh_.locator().find(x, latest_));
  return at.slot < 0 ? at : LocalBrick{at.slot, box(at.slot).find(x)};
}

/// A brick among those of this rank, if it serves any of its particles.
Classifier::LocalBrick Classifier::local(Home const& home) {
  if (out_.bricks.is_own(home)) return {mesh_.slot(home.level, home.box), home.brick};
  Part const of_brick = part_of(home);
  if (of_brick == Part::none) return {};
  int const slot = own_slots() + out_.bricks.number(home) - mesh_.bricks();
  if (slot == own_slots() + int(remote_.size())) {
    remote_.emplace_back(mesh_.locator(), home);
    parts_.push_back(static_cast<signed char>(of_brick));
    out_.per_brick.push_back(0);
  }
  return {slot, 0};
}

/// Where x lies, if that is in a box that was found next to the current one.
Classifier::LocalBrick Classifier::find_in_neighbours(Real3 const& x) const {
  if (current_.slot < 0) return {};
  int const next = neighbours_[std::size_t(current_box().direction(x))];
  return next < 0 ? LocalBrick{} : LocalBrick{next, box(next).find(x)};
}

/// Find the home of a particle wherever it lies.
void Classifier::look_up(LocalIndex n) {
  Real3 const before = particles_.at(n);
  Real3 x = before;
  if (!is_finite(before)) {
    out_.finite = false;
    return;
  }
  if (!mesh_.locator().wrap(x)) {
    out_.finite = out_.finite && is_finite(particles_.momentum_at(n));
    out_.lost.push_back(n);
    return;
  }
  bool const wrapped = x != before;
  if (wrapped && current_.slot >= 0) {  // mostly it is near where it was again
    LocalBrick at{current_.slot, current_box().find(x)};
    if (at.brick < 0) at = find_in_neighbours(x);
    if (at.brick >= 0 && serves(at, n)) return move_to(number(at), n, out_.wrapped);
  }
  latest_ = mesh_.locator().find(x, latest_);
  int const server = alone() ? 0 : server_of(latest_, n);
  if (server != mesh_.hierarchy().comm().rank()) {
    out_.leavers[std::size_t(server)].push_back({n, latest_, wrapped});
    return;
  }
  LocalBrick const at = local(latest_);
  move_to(number(at), n, wrapped ? out_.wrapped : out_.movers);
  if (current_.slot >= 0) neighbours_[std::size_t(current_box().direction(x))] = at.slot;
}

void Classifier::move_to(LocalIndex brick, LocalIndex n, std::vector<Destinations::Mover>& movers) {
  movers.push_back({n, brick});
  ++out_.per_brick[std::size_t(brick)];
}

}  // namespace

LocalIndex BrickNumbers::number(Home const& brick) {
  if (is_own(brick)) return mesh_->first_brick(mesh_->slot(brick.level, brick.box)) + brick.brick;
  std::uint64_t const key =
      (std::uint64_t(brick.level) << 32 | std::uint64_t(brick.box)) << 24 | std::uint64_t(brick.brick);
  auto const [at, is_new] = place_.try_emplace(key, LocalIndex(remote_.size()));
  if (is_new) remote_.push_back(brick);
  return mesh_->bricks() + at->second;
}

Destinations classify(ParticleMesh& mesh, Servers const& servers, ParticleView const& particles,
                      ParticleList const& gone) {
  return Classifier(mesh, servers, particles, gone).classify();
}

}  // namespace amrpic
