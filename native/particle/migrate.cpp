#include "particle/migrate.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numeric>
#include <optional>
#include <stdexcept>

#include "base/fetch.hpp"

namespace amrpic {

namespace {

/// Particles that are copied one column after the other: so many that memory is read in long rows, so few that a column
/// of them stays in the second-level cache for those that left.
constexpr LocalIndex batch_size = 4096;

bool is_finite(Real3 const& v) { return std::isfinite(v[0]) && std::isfinite(v[1]) && std::isfinite(v[2]); }

/// Throw std::length_error on all ranks if one of them has too many particles for a LocalIndex. Collective.
void require_few(std::int64_t particles, Communicator const& comm) {
  if (comm.largest(particles) > std::numeric_limits<LocalIndex>::max() - batch_size)
    throw std::length_error("more than 2^31 particles on one rank; use more ranks");
}

/// Running sums of counts, from zero.
std::vector<std::int64_t> starts_of(std::vector<std::int64_t> const& counts) {
  std::vector<std::int64_t> out(counts.size() + 1, 0);
  std::partial_sum(counts.begin(), counts.end(), out.begin() + 1);
  return out;
}

/// Copy those of the values [first, last) whose bits are set; there are `count` values, and `first` is a multiple of
/// eight. Whole cache lines of `to` are written past the cache if they are `far`. False if values are to be checked and
/// one of those passed is not finite.
///
/// Those whose bits are set are first put side by side in a buffer, and leave it some lines later: a processor waits
/// where it reads what two stores wrote just before.
bool copy_chosen(Real const* from, LocalIndex first, LocalIndex last, std::int64_t count, std::uint8_t const* bits,
                 Real* to, bool far, bool check) {
  constexpr int buffered = 512;
  alignas(sizeof(Lanes)) Real buffer[buffered + lane_count];
  int waiting =
      int(reinterpret_cast<std::uintptr_t>(to) / sizeof(Real) % lane_count);  // at first, what lies before `to`
  unsigned lanes = all_lanes << waiting & all_lanes;                          // of the line that is next
  to -= waiting;
  auto const write_lines = [&] {
    int const whole = waiting / lane_count * lane_count;
    for (int n = 0; n < whole; n += lane_count, lanes = all_lanes)
      store(to + n, {0, lanes}, load<Lanes>(buffer + n), far);
    store(buffer, load<Lanes>(buffer + whole));
    to += whole;
    waiting -= whole;
  };
  Lanes zero{};  // nan as soon as a value is not finite
  for (LocalIndex n = first; n < last; n += lane_count, ++bits) {
    bring_near(from + n + page<Real>);
    Lanes const values = load_up_to(from + n, count - n);
    if (check) zero += values - values;
    waiting += compress(*bits, values, buffer + waiting);
    if (waiting >= buffered) write_lines();
  }
  write_lines();
  if (waiting > 0) store(to, {0, lanes & all_lanes >> (lane_count - waiting)}, load<Lanes>(buffer), far);
  return bits_of(zero == 0) == all_lanes;
}

}  // namespace

// ---- homes ----

Migration::Migration(ParticleMesh& mesh, ParticleView const& particles)
    : mesh_(mesh),
      particles_(particles),
      stays_(std::size_t(particles.count) / lane_count + 1),
      leaving_(std::size_t(mesh.hierarchy().level(0).ranks())) {
  require_few(particles.count, mesh.hierarchy().comm());
  first_brick_.push_back(0);
  for (HomeBox const& box : mesh.homes()) first_brick_.push_back(first_brick_.back() + box.bricks());
  next_.assign(std::size_t(first_brick_.back()), 0);
  neighbours_.fill(-1);
  compare();
  announce();
}

/// Compare each particle with the brick of its neighbour in memory.
void Migration::compare() {
  LocalIndex const count = LocalIndex(particles_.count), whole = count / lane_count * lane_count;
  for (LocalIndex n = 0; n < whole; n += lane_count) {
    for (int d = 0; d < 3; ++d) bring_near(particles_.position[d] + n + page<Real>);
    compare({n, all_lanes});
  }
  if (whole < count) compare({whole, all_lanes >> (lane_count - (count - whole))});
  find_leavers();
  end_run(count);
}

/// Compare a group with the current brick, or with that of its last particle.
inline void Migration::compare(LaneGroup const& group) {
  unsigned out = outside(current_brick_, group);
  if (2 * __builtin_popcount(out) > __builtin_popcount(group.lanes)) {
    find_leavers();
    out = begin_run(group, out);
  }
  LocalIndex const n = LocalIndex(group.first);
  stays_[std::size_t(n / lane_count)] = std::uint8_t(group.lanes & ~out);
  run_.stayed += __builtin_popcount(group.lanes & ~out);
  left_count_ += compress(out, n + index_of_lane, left_ + left_count_);
  if (left_count_ > block_size - lane_count) find_leavers();
}

/// A bit for each particle of a group that lies outside a brick.
inline unsigned Migration::outside(HomeBrick const& brick, LaneGroup const& group) const {
  std::array<Lanes, 3> x;
  for (int d = 0; d < 3; ++d) x[d] = load(particles_.position[d], group);
  return ~bits_of(brick.contains(x)) & group.lanes;
}

/// Find where the particles are that left the current brick: mostly in its box, else mostly in one next to it.
void Migration::find_leavers() {
  auto const& at = particles_.position;
  for (int first = 0; first < left_count_; first += lane_count) {
    LocalIndex const* const n = left_ + first;
    IndexLanes brick = IndexLanes{} - 1;
    if (run_.at.slot >= 0) brick = current_box().find({pick(at[0], n), pick(at[1], n), pick(at[2], n)});
    for (int i = 0; i < std::min(lane_count, left_count_ - first); ++i)
      if (brick[i] >= 0)
        move_to({run_.at.slot, brick[i]}, n[i], movers_);
      else if (LocalBrick const at = find_in_neighbours(particles_.at(n[i])); at.brick >= 0)
        move_to(at, n[i], movers_);
      else
        look_up(n[i]);
  }
  left_count_ = 0;
}

/// Make the brick of a group's last particle the current one if it contains more of the group than the current one,
/// outside which `out` lie. Return which lie outside the brick that is current now.
unsigned Migration::begin_run(LaneGroup const& group, unsigned out) {
  Real3 const x = particles_.at(group.first + group.last());
  LocalBrick at;
  if (run_.at.slot >= 0) at = {run_.at.slot, current_box().find(x)};
  if (at.brick < 0) at = find_in_neighbours(x);
  if (at.brick < 0) at = find(x);
  if (at.brick < 0) return out;
  HomeBrick const next = mesh_.homes()[std::size_t(at.slot)].brick(at.brick);
  unsigned const out_of_next = outside(next, group);
  if (__builtin_popcount(out_of_next) >= __builtin_popcount(out)) return out;
  LocalIndex const n = LocalIndex(group.first);
  end_run(n);
  if (at.slot != run_.at.slot) neighbours_.fill(-1);
  current_brick_ = next;
  run_ = {at, n, n, 0};
  return out_of_next;
}

void Migration::end_run(LocalIndex last) {
  run_.last = last;
  if (run_.stayed == 0) return;
  runs_.push_back(run_);
  next_[std::size_t(number(run_.at))] += run_.stayed;
  staying_ += run_.stayed;
}

/// Where x lies, if that is in one of this rank's bricks, and no finer box may contain it.
Migration::LocalBrick Migration::find(Real3 const& x) {
  Real3 wrapped = x;
  if (!is_finite(x) || !mesh_.locator().wrap(wrapped) || wrapped != x) return {};
  Home const home = mesh_.locator().find(x, latest_);
  Level const& level = mesh_.hierarchy().level(home.level);
  if (level.owner(home.box) != level.rank()) return {};
  int const slot = mesh_.slot(home.level, home.box);
  return {slot, mesh_.homes()[std::size_t(slot)].find(x)};
}

/// Where x lies, if that is in a box that was found next to the current one.
Migration::LocalBrick Migration::find_in_neighbours(Real3 const& x) const {
  if (run_.at.slot < 0) return {};
  int const next = neighbours_[std::size_t(current_box().direction(x))];
  return next < 0 ? LocalBrick{} : LocalBrick{next, mesh_.homes()[std::size_t(next)].find(x)};
}

void Migration::move_to(LocalBrick const& at, LocalIndex n, Movers& movers) {
  movers.all.push_back({n, number(at)});
  ++next_[std::size_t(number(at))];
  ++staying_;
}

/// Find the home of a particle wherever it lies.
void Migration::look_up(LocalIndex n) {
  Real3 const before = particles_.at(n);
  Real3 x = before;
  if (!is_finite(before)) {
    finite_ = false;
    return;
  }
  if (!mesh_.locator().wrap(x)) {
    finite_ = finite_ && is_finite(particles_.momentum_at(n));
    lost_.push_back(n);
    return;
  }
  latest_ = mesh_.locator().find(x, latest_);
  Level const& level = mesh_.hierarchy().level(latest_.level);
  int const owner = level.owner(latest_.box);
  if (owner == level.rank()) {
    int const slot = mesh_.slot(latest_.level, latest_.box);
    move_to({slot, latest_.brick}, n, x == before ? movers_ : wrapped_);
    if (run_.at.slot >= 0 && x == before) neighbours_[std::size_t(current_box().direction(x))] = slot;
  } else {
    leaving_[owner].push_back({n, latest_});
  }
}

// ---- to other ranks ----

/// Pack what leaves, and exchange how much will come.
void Migration::announce() {
  std::vector<std::int64_t> leaving, coming(leaving_.size(), 0);
  std::vector<std::pair<int, std::int64_t>> to;
  for (auto const& to_rank : leaving_) {
    leaving.push_back(std::int64_t(to_rank.size()));
    if (leaving.back() > 0) to.emplace_back(int(leaving.size()) - 1, leaving.back());
  }
  for (auto const& [rank, count] : mesh_.hierarchy().comm().announced(to)) coming[std::size_t(rank)] = count;
  sent_start_ = starts_of(leaving);
  received_start_ = starts_of(coming);
  require_few(arriving(), mesh_.hierarchy().comm());
  sent_.reserve(std::size_t(sent_start_.back()));
  for (auto const& to_rank : leaving_)
    for (auto const& [n, home] : to_rank) {
      Real3 const before = particles_.at(n), momentum = particles_.momentum_at(n);
      Real3 x = before;
      mesh_.locator().wrap(x);
      finite_ = finite_ && is_finite(momentum);
      sent_.push_back(
          {x, momentum, particles_.weight_of(n), particles_.id[n], home.level, home.box, home.brick, x != before});
    }
}

void Migration::exchange() {
  Communicator const& comm = mesh_.hierarchy().comm();
  received_.resize(std::size_t(received_start_.back()));
  Messages messages;
  auto for_each_part = [](std::vector<std::int64_t> const& start, auto&& f) {
    for (std::size_t r = 0; r + 1 < start.size(); ++r)
      if (start[r] < start[r + 1]) f(int(r), std::size_t(start[r]), std::size_t(start[r + 1] - start[r]));
  };
  for_each_part(received_start_, [&](int rank, std::size_t first, std::size_t count) {
    messages.receive(comm, received_.data() + first, count, rank);
  });
  for_each_part(sent_start_, [&](int rank, std::size_t first, std::size_t count) {
    messages.send(comm, sent_.data() + first, count, rank);
  });
  messages.wait_for_all();
}

// ---- to their places ----

bool Migration::finish(ParticleView const& out, std::int64_t* starts) {
  exchange();
  assign_places(starts);
  pair_columns(out);
  std::size_t const rank = std::size_t(mesh_.hierarchy().level(0).rank());
  LocalIndex const all = LocalIndex(particles_.count);
  std::int64_t const lower = received_start_[rank], end = received_start_.back();
  unpack(0, lower, false, out);
  for (ParticleRun const& run : runs_) {
    assign_movers(movers_, run.first);
    for (LocalIndex first = run.first; first < run.last; first += batch_size) {
      LocalIndex const last = std::min(run.last, first + batch_size);
      assign_stayers(run.at, first, last);
      assign_movers(movers_, last);
    }
  }
  assign_movers(movers_, all);
  unpack(lower, end, false, out);

  unpack(0, lower, true, out);
  assign_movers(wrapped_, all);
  unpack(lower, end, true, out);
  copy_assigned();
  stream_end();
  return finite_;
}

/// Let columns be copied to those of `out`, of which positions come first.
void Migration::pair_columns(ParticleView const& out) {
  for (int d = 0; d < 3; ++d) columns_.push_back({particles_.position[d], out.position[d], false});
  for (int d = 0; d < 3; ++d) columns_.push_back({particles_.momentum[d], out.momentum[d], true});
  columns_.push_back({reinterpret_cast<Real const*>(particles_.id), reinterpret_cast<Real*>(out.id), false});
  if (!out.equal_weights) columns_.push_back({particles_.weight, out.weight, false});
}

/// Let starts[s] be where slot s starts, and `next_` where each brick does.
void Migration::assign_places(std::int64_t* starts) {
  for (Parcel const& p : received_) ++next_[std::size_t(number({mesh_.slot(p.level, p.box), p.brick}))];
  std::exclusive_scan(next_.begin(), next_.end(), next_.begin(), std::int64_t(0));
  for (std::size_t s = 0; s < mesh_.boxes().size(); ++s) starts[s] = next_[std::size_t(first_brick_[s])];
  starts[mesh_.boxes().size()] = arriving();
}

/// Assign their places to those of the particles [first, last) that stayed in their brick.
void Migration::assign_stayers(LocalBrick const& at, LocalIndex first, LocalIndex last) {
  std::int64_t& next = next_[std::size_t(number(at))];
  assigned_.stayers.push_back({first, last, next});
  for (LocalIndex n = first; n < last; n += lane_count) next += __builtin_popcount(stays_[std::size_t(n / lane_count)]);
  copy_a_batch(last - first);
}

/// Assign theirs to the movers whose places are before `last`.
void Migration::assign_movers(Movers& movers, LocalIndex last) {
  auto const& all = movers.all;
  for (; movers.assigned < all.size() && all[movers.assigned].place < last; ++movers.assigned) {
    Mover const& mover = all[movers.assigned];
    std::int64_t const to = next_[std::size_t(mover.brick)]++;
    for (Column const& column : columns_) fetch<Use::write>(column.to + to, 1);
    assigned_.movers.push_back({mover.place, to, movers.wrapped});
    copy_a_batch(1);
  }
}

/// `more` particles have been assigned places: copy all that have one as soon as they fill a batch.
void Migration::copy_a_batch(LocalIndex more) {
  assigned_.count += more;
  if (assigned_.count >= batch_size) copy_assigned();
}

/// Copy all particles that have been assigned places, one column after the other.
void Migration::copy_assigned() {
  for (Column const& c : columns_) {
    bool const far = are_far(arriving(), c.to);
    for (Stayers const& some : assigned_.stayers)
      finite_ &= copy_chosen(c.from, some.first, some.last, particles_.count, stays_.data() + some.first / lane_count,
                             c.to + some.to, far, c.is_momentum);
    Real zero = 0;  // nan as soon as a momentum is not finite
    for (AssignedMover const& mover : assigned_.movers) {
      Real const value = c.to[mover.to] = c.from[mover.from];
      if (c.is_momentum) zero += value - value;
    }
    finite_ = finite_ && zero == 0;
  }
  for (AssignedMover const& mover : assigned_.movers)
    if (mover.wrapped) {
      Real3 x = particles_.at(mover.from);
      mesh_.locator().wrap(x);
      for (std::size_t d = 0; d < 3; ++d) columns_[d].to[mover.to] = x[d];
    }
  assigned_.stayers.clear();
  assigned_.movers.clear();
  assigned_.count = 0;
}

/// Write those of the received particles [first, last) that were wrapped, or those that were not.
void Migration::unpack(std::int64_t first, std::int64_t last, bool wrapped, ParticleView const& out) {
  for (std::int64_t n = first; n < last; ++n) {
    Parcel const& parcel = received_[std::size_t(n)];
    if (parcel.wrapped != wrapped) continue;
    std::int64_t const to = next_[std::size_t(number({mesh_.slot(parcel.level, parcel.box), parcel.brick}))]++;
    for (int d = 0; d < 3; ++d) out.position[d][to] = parcel.position[d], out.momentum[d][to] = parcel.momentum[d];
    if (!out.equal_weights) out.weight[to] = parcel.weight;
    out.id[to] = parcel.id;
  }
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
