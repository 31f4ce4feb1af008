#include "particle/classify.hpp"

#include <algorithm>
#include <optional>

#include "base/fetch.hpp"
#include "particle/home_box.hpp"
#include "particle/lane_groups.hpp"

namespace amrpic {

namespace {

/// Particles that were sorted before they moved mostly lie in the brick of their neighbour in memory. So eight at a
/// time are compared with the current brick, and only those that left it are looked up.
class Classifier {
 public:
  Classifier(ParticleMesh& mesh, ParticleView const& particles, ParticleList const& gone)
      : mesh_(mesh), particles_(particles), next_gone_(gone.first), end_of_gone_(gone.last) {
    out_.stays = Scratch<std::uint8_t>(std::size_t(particles.count) / lane_count + 1);
    out_.leavers.resize(std::size_t(mesh.hierarchy().comm().ranks()));
    out_.per_brick.assign(std::size_t(mesh.bricks()), 0);
    neighbours_.fill(-1);
  }

  Destinations classify() &&;

 private:
  /// A brick of this rank; none if negative.
  struct LocalBrick {
    int slot = -1, brick = -1;
  };

  LaneGroup remaining(LaneGroup const& group);
  void compare(LaneGroup const& group);
  unsigned outside(HomeBrick const& brick, LaneGroup const& group) const;
  void find_leavers();
  unsigned begin_run(LaneGroup const& group, unsigned out);
  void end_run(LocalIndex last);
  LocalBrick find(Real3 const& x);
  LocalBrick find_in_neighbours(Real3 const& x) const;
  void look_up(LocalIndex n);
  void move_to(LocalBrick const& at, LocalIndex n, std::vector<Destinations::Mover>& movers);
  HomeBox const& current_box() const { return mesh_.homes()[std::size_t(current_.slot)]; }
  LocalIndex number(LocalBrick const& at) const { return mesh_.first_brick(at.slot) + at.brick; }

  ParticleMesh& mesh_;
  ParticleView const& particles_;
  std::int64_t const *next_gone_, *end_of_gone_;
  Destinations out_;
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
  unsigned out = outside(current_brick_, group);
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

/// A bit for each particle of a group that lies outside a brick.
inline unsigned Classifier::outside(HomeBrick const& brick, LaneGroup const& group) const {
  std::array<Lanes, 3> x;
  for (int d = 0; d < 3; ++d) x[d] = load(particles_.position[d], group);
  return ~bits_of(brick.contains(x)) & group.lanes;
}

/// Find where the particles are that left the current brick: mostly in its box, else mostly in one next to it.
void Classifier::find_leavers() {
  auto const& at = particles_.position;
  for (int first = 0; first < left_count_; first += lane_count) {
    LocalIndex const* const n = left_ + first;
    IndexLanes brick = IndexLanes{} - 1;
    if (current_.slot >= 0) brick = current_box().find({pick(at[0], n), pick(at[1], n), pick(at[2], n)});
    for (int i = 0; i < std::min(lane_count, left_count_ - first); ++i)
      if (brick[i] >= 0)
        move_to({current_.slot, brick[i]}, n[i], out_.movers);
      else if (LocalBrick const next = find_in_neighbours(particles_.at(n[i])); next.brick >= 0)
        move_to(next, n[i], out_.movers);
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
  if (at.brick < 0) return out;
  HomeBrick const next = mesh_.homes()[std::size_t(at.slot)].brick(at.brick);
  unsigned const out_of_next = outside(next, group);
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

/// Where x lies, if that is in one of this rank's bricks, and no finer box may contain it.
Classifier::LocalBrick Classifier::find(Real3 const& x) {
  Real3 wrapped = x;
  if (!is_finite(x) || !mesh_.locator().wrap(wrapped) || wrapped != x) return {};
  Home const home = mesh_.locator().find(x, latest_);
  Level const& level = mesh_.hierarchy().level(home.level);
  if (level.owner(home.box) != level.rank()) return {};
  int const slot = mesh_.slot(home.level, home.box);
  return {slot, mesh_.homes()[std::size_t(slot)].find(x)};
}

/// Where x lies, if that is in a box that was found next to the current one.
Classifier::LocalBrick Classifier::find_in_neighbours(Real3 const& x) const {
  if (current_.slot < 0) return {};
  int const next = neighbours_[std::size_t(current_box().direction(x))];
  return next < 0 ? LocalBrick{} : LocalBrick{next, mesh_.homes()[std::size_t(next)].find(x)};
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
  latest_ = mesh_.locator().find(x, latest_);
  Level const& level = mesh_.hierarchy().level(latest_.level);
  int const owner = level.owner(latest_.box);
  if (owner != level.rank()) {
    out_.leavers[std::size_t(owner)].push_back({n, latest_});
    return;
  }
  int const slot = mesh_.slot(latest_.level, latest_.box);
  move_to({slot, latest_.brick}, n, x == before ? out_.movers : out_.wrapped);
  if (current_.slot >= 0 && x == before) neighbours_[std::size_t(current_box().direction(x))] = slot;
}

void Classifier::move_to(LocalBrick const& at, LocalIndex n, std::vector<Destinations::Mover>& movers) {
  movers.push_back({n, number(at)});
  ++out_.per_brick[std::size_t(number(at))];
}

}  // namespace

Destinations classify(ParticleMesh& mesh, ParticleView const& particles, ParticleList const& gone) {
  return Classifier(mesh, particles, gone).classify();
}

std::vector<std::vector<std::int64_t>> count_per_box(Locator& locator, std::array<Real*, 3> const& position,
                                                     std::int64_t count) {
  std::vector<std::vector<std::int64_t>> out;
  std::vector<std::vector<std::optional<HomeBox>>> homes;  // made when first wanted
  for (int l = 0; l < locator.hierarchy().level_count(); ++l) {
    out.emplace_back(std::size_t(locator.hierarchy().level(l).box_count()), 0);
    homes.emplace_back(out.back().size());
  }
  Home home;
  auto const count_one = [&](std::int64_t n) {
    Real3 x{position[0][n], position[1][n], position[2][n]};
    if (!is_finite(x) || !locator.wrap(x)) return;
    home = locator.find(x, home);
    ++out[home.level][home.box];
  };
  auto const all_in_last_one = [&](std::int64_t first) {
    if (home.box < 0) return false;
    auto& box = homes[home.level][home.box];
    if (!box) box.emplace(locator, home.level, home.box);
    LaneGroup const group{first, all_lanes};
    auto const bricks = box->find({load(position[0], group), load(position[1], group), load(position[2], group)});
    return bits_of(bricks >= 0) == all_lanes;
  };
  for (std::int64_t first = 0; first < count; first += lane_count) {
    if (first + lane_count <= count && all_in_last_one(first))
      out[home.level][home.box] += lane_count;
    else
      for (std::int64_t n = first; n < std::min(first + lane_count, count); ++n) count_one(n);
  }
  return out;
}

}  // namespace amrpic
