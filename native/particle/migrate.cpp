#include "particle/migrate.hpp"

#include <mpi.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <tuple>

#include "base/fetch.hpp"

namespace amrpic {

namespace {

constexpr int tag_particles = 7201;

bool is_finite(Real3 const& v) { return std::isfinite(v[0]) && std::isfinite(v[1]) && std::isfinite(v[2]); }

void require_few(std::int64_t particles) {
  if (particles > std::numeric_limits<LocalIndex>::max() - block_size)
    throw std::length_error("more than 2^31 particles on one rank; use more ranks");
}

/// Running sums of counts, from zero.
std::vector<std::int64_t> starts_of(std::vector<std::int64_t> const& counts) {
  std::vector<std::int64_t> out(counts.size() + 1, 0);
  std::partial_sum(counts.begin(), counts.end(), out.begin() + 1);
  return out;
}

}  // namespace

// ---- homes ----

Migration::Migration(ParticleMesh& mesh, ParticleView const& particles)
    : mesh_(mesh),
      particles_(particles),
      stays_(std::size_t(particles.count) / lane_count + 1),
      movers_(mesh.boxes().size()),
      leaving_(std::size_t(mesh.hierarchy().level(0).ranks())),
      order_(particles) {
  require_few(particles.count);
  next_door_.fill(-1);
  hold();
  announce();
}

/// Hold each particle against the brick of its neighbour in memory.
void Migration::hold() {
  LocalIndex const count = LocalIndex(particles_.count), whole = count / lane_count * lane_count;
  for (LocalIndex n = 0; n < whole; n += lane_count) {
    for (int d = 0; d < 3; ++d) bring_near(particles_.position[d] + n + page<Real>);
    hold({n, all_lanes});
  }
  if (whole < count) hold({whole, all_lanes >> (lane_count - (count - whole))});
  look_after();
  end_run(count);
}

/// Hold a group against the brick at hand, or against that of its last particle.
inline void Migration::hold(LaneGroup const& group) {
  unsigned out = outside(at_hand_, group);
  if (2 * __builtin_popcount(out) > __builtin_popcount(group.lanes)) {
    look_after();
    out = begin_run(group, out);
  }
  LocalIndex const n = LocalIndex(group.first);
  stays_[std::size_t(n / lane_count)] = std::uint8_t(group.lanes & ~out);
  run_.stayed += __builtin_popcount(group.lanes & ~out);
  left_count_ += compress(out, n + index_of_lane, left_ + left_count_);
  if (left_count_ > block_size - lane_count) look_after();
}

/// A bit for each particle of a group that lies outside a brick.
inline unsigned Migration::outside(HomeBrick const& brick, LaneGroup const& group) const {
  std::array<Lanes, 3> x;
  for (int d = 0; d < 3; ++d) x[d] = load(particles_.position[d], group);
  return ~bits_of(brick.holds(x)) & group.lanes;
}

/// Find where those live who left the brick at hand.
void Migration::look_after() {
  for (int i = 0; i < left_count_; ++i)
    if (Place const place = known(particles_.at(left_[i])); place.brick >= 0)
      move_to(place, left_[i]);
    else
      look_up(left_[i]);
  left_count_ = 0;
}

/// Take the brick of a group's last particle to hand if that holds more of the group than the one at hand, outside
/// which `out` lie. Return who lies outside the brick that is at hand now.
unsigned Migration::begin_run(LaneGroup const& group, unsigned out) {
  Real3 const x = particles_.at(group.first + group.last());
  Place place = known(x);
  if (place.brick < 0) place = find(x);
  if (place.brick < 0) return out;
  HomeBrick const next = mesh_.homes()[std::size_t(place.slot)].brick(place.brick);
  unsigned const out_of_next = outside(next, group);
  if (__builtin_popcount(out_of_next) >= __builtin_popcount(out)) return out;
  LocalIndex const n = LocalIndex(group.first);
  end_run(n);
  if (place.slot != run_.slot) next_door_.fill(-1);
  at_hand_ = next;
  run_ = {place.slot, place.brick, n, n, 0};
  return out_of_next;
}

void Migration::end_run(LocalIndex last) {
  run_.last = last;
  if (run_.slot < 0 || run_.stayed == 0) return;
  runs_.push_back(run_);
  staying_ += run_.stayed;
}

/// Where x lies, if that is in one of this rank's bricks, and no finer box may hold it.
Migration::Place Migration::find(Real3 const& x) {
  Real3 wrapped = x;
  if (!is_finite(x) || !mesh_.locator().wrap(wrapped) || wrapped != x) return {};
  Home const home = mesh_.locator().find(x, latest_);
  Level const& level = mesh_.hierarchy().level(home.level);
  if (level.owner(home.box) != level.rank()) return {};
  int const slot = mesh_.slot(home.level, home.box);
  return {slot, mesh_.homes()[std::size_t(slot)].find(x)};
}

/// Where x lies, if that is in the box at hand, or in one that was found around it.
Migration::Place Migration::known(Real3 const& x) const {
  if (run_.slot < 0) return {};
  HomeBox const& box = mesh_.homes()[std::size_t(run_.slot)];
  if (int const brick = box.find(x); brick >= 0) return {run_.slot, brick};
  int const next = next_door_[std::size_t(box.direction(x))];
  return next < 0 ? Place{} : Place{next, mesh_.homes()[std::size_t(next)].find(x)};
}

void Migration::move_to(Place const& place, LocalIndex n) {
  movers_[std::size_t(place.slot)].push_back({place.brick, n});
  ++staying_;
}

/// Find the home of a particle wherever it lies.
void Migration::look_up(LocalIndex n) {
  Real3 const before = particles_.at(n);
  if (!is_finite(before) || !is_finite(particles_.momentum_at(n))) {
    finite_ = false;
    return;
  }
  Real3 x = before;
  if (!mesh_.locator().wrap(x)) {
    lost_.push_back(n);
    return;
  }
  latest_ = mesh_.locator().find(x, latest_);
  Level const& level = mesh_.hierarchy().level(latest_.level);
  int const owner = level.owner(latest_.box);
  if (owner == level.rank() && x == before) {
    int const slot = mesh_.slot(latest_.level, latest_.box);
    move_to({slot, latest_.brick}, n);
    if (run_.slot >= 0) next_door_[std::size_t(mesh_.homes()[std::size_t(run_.slot)].direction(x))] = slot;
  } else {
    leaving_[owner].push_back({n, latest_});
  }
}

// ---- to other ranks ----

/// Pack what leaves, and tell the ranks how much will come.
void Migration::announce() {
  std::vector<std::int64_t> leaving, coming(leaving_.size(), 0);
  for (auto const& to_rank : leaving_) leaving.push_back(std::int64_t(to_rank.size()));
  MPI_Alltoall(leaving.data(), 1, MPI_INT64_T, coming.data(), 1, MPI_INT64_T, mesh_.hierarchy().comm());
  sent_start_ = starts_of(leaving);
  received_start_ = starts_of(coming);
  require_few(particles_.count + received_start_.back());
  sent_.reserve(std::size_t(sent_start_.back()));
  for (auto const& to_rank : leaving_)
    for (auto const& [n, home] : to_rank) {
      Real3 x = particles_.at(n);
      mesh_.locator().wrap(x);
      sent_.push_back(
          {x, particles_.momentum_at(n), particles_.weight[n], particles_.id[n], home.level, home.box, home.brick});
    }
}

void Migration::exchange() {
  MPI_Comm const comm = mesh_.hierarchy().comm();
  int const ranks = int(leaving_.size());
  // Counted in whole parcels, so that 32-bit message lengths suffice for 2^31 particles.
  MPI_Datatype parcel;
  MPI_Type_contiguous(int(sizeof(Parcel)), MPI_BYTE, &parcel);
  MPI_Type_commit(&parcel);
  received_.resize(std::size_t(received_start_.back()));
  std::vector<MPI_Request> requests;
  for (int r = 0; r < ranks; ++r)
    if (int const n = int(received_start_[r + 1] - received_start_[r]); n > 0)
      MPI_Irecv(received_.data() + received_start_[r], n, parcel, r, tag_particles, comm, &requests.emplace_back());
  for (int r = 0; r < ranks; ++r)
    if (int const n = int(sent_start_[r + 1] - sent_start_[r]); n > 0)
      MPI_Isend(sent_.data() + sent_start_[r], n, parcel, r, tag_particles, comm, &requests.emplace_back());
  MPI_Waitall(int(requests.size()), requests.data(), MPI_STATUSES_IGNORE);
  MPI_Type_free(&parcel);
}

// ---- to their places ----

bool Migration::finish(ParticleView const& out, std::int64_t* starts) {
  exchange();
  for (std::size_t r = 0; r < received_.size(); ++r) {
    Parcel const& p = received_[r];
    auto& movers = movers_[std::size_t(mesh_.slot(p.level, p.box))];
    movers.push_back({p.brick, LocalIndex(particles_.count + std::int64_t(r))});
  }
  count(starts);
  auto const by_brick = [](Run const& a, Run const& b) {
    return std::tie(a.slot, a.brick) < std::tie(b.slot, b.brick);
  };
  if (!std::is_sorted(runs_.begin(), runs_.end(), by_brick)) std::stable_sort(runs_.begin(), runs_.end(), by_brick);
  auto const& [x, p] = std::tie(out.position, out.momentum);
  bool const far = are_far(arriving(), x[0], x[1], x[2], p[0], p[1], p[2], out.weight, out.id);
  Run const* run = runs_.data();
  for (std::size_t s = 0; s < movers_.size(); ++s) {
    if (starts[s] == starts[s + 1]) continue;
    group_movers(s);
    for (int b = 0; b < mesh_.homes()[s].bricks(); ++b) {
      for (LocalIndex i = first_mover_[b + 1]; i < first_mover_[b + 2]; ++i) bring_near(particles_.id + mover_[i]);
      Run const* const first = run;
      while (run < runs_.data() + runs_.size() && run->slot == int(s) && run->brick == b) ++run;
      line_up(first, run, mover_.data() + first_mover_[b], first_mover_[b + 1] - first_mover_[b]);
      finite_ = order_.write_most(out, far) && finite_;
    }
    movers_[s] = {};
  }
  finite_ = order_.write_rest(out, far) && finite_;
  for (auto const& [n, place] : arrived_) {
    Parcel const& parcel = received_[std::size_t(place)];
    for (int d = 0; d < 3; ++d) out.position[d][n] = parcel.position[d], out.momentum[d][n] = parcel.momentum[d];
    out.weight[n] = parcel.weight;
    out.id[n] = parcel.id;
  }
  stream_end();
  return finite_;
}

/// Let starts[s] be where slot s starts.
void Migration::count(std::int64_t* starts) const {
  starts[0] = 0;
  for (std::size_t s = 0; s < movers_.size(); ++s) starts[s + 1] = std::int64_t(movers_[s].size());
  for (Run const& run : runs_) starts[run.slot + 1] += run.stayed;
  std::partial_sum(starts, starts + movers_.size() + 1, starts);
}

/// Let mover first_mover_[b] be the first one that comes into brick b of a slot's box.
void Migration::group_movers(std::size_t slot) {
  auto const& movers = movers_[slot];
  first_mover_.assign(std::size_t(mesh_.homes()[slot].bricks()) + 2, 0);
  for (Mover const& mover : movers) ++first_mover_[std::size_t(mover.brick) + 2];
  std::partial_sum(first_mover_.begin(), first_mover_.end(), first_mover_.begin());
  mover_.resize(movers.size());
  for (Mover const& mover : movers) mover_[std::size_t(first_mover_[std::size_t(mover.brick) + 1]++)] = mover.place;
}

std::int64_t Migration::id_at(LocalIndex place) const {
  std::int64_t const beyond = place - particles_.count;
  return beyond < 0 ? particles_.id[place] : received_[std::size_t(beyond)].id;
}

/// Call f(n, bits) for each eight particles from place n on of runs [first, last), with the bits of those who stayed.
template <class F>
void Migration::for_each_group(Run const* first, Run const* last, F&& f) const {
  for (Run const* run = first; run < last; ++run)
    for (LocalIndex n = run->first; n < run->last; n += lane_count) f(n, stays_[std::size_t(n / lane_count)]);
}

/// Let the particles of one brick be written next, in order of their ids: those who stayed in it in runs [first, last),
/// mostly one that is in order, and the movers, who are put in order here.
void Migration::line_up(Run const* first, Run const* last, LocalIndex* movers, LocalIndex count) {
  LocalIndex stayed = 0;
  for (Run const* run = first; run < last; ++run) stayed += run->stayed;
  if (stayed_id_.size() < std::size_t(stayed + lane_count)) stayed_id_.resize(2 * std::size_t(stayed + lane_count));
  LocalIndex known = 0;
  for_each_group(first, last, [&](LocalIndex n, unsigned stays) {
    bring_near(particles_.id + n + page<Real>);
    auto const ids = load_up_to<WideLanes>(particles_.id + n, particles_.count - n);
    known += compress(stays, ids, stayed_id_.data() + known);
  });
  if (!are_in_order(stayed_id_.data(), stayed)) return line_up_all(first, last, movers, count);

  came_id_.resize(std::size_t(count));
  for (LocalIndex i = 0; i < count; ++i) came_id_[std::size_t(i)] = id_at(movers[i]);
  sort_by_id({came_id_.data(), movers}, count);
  for_each_group(first, last, [&](LocalIndex n, unsigned stays) { order_.keep(n, stays); });
  for (LocalIndex i = 0; i < count; ++i)
    insert(movers[i], order_.known() + i + count_smaller(stayed_id_.data(), stayed, came_id_[std::size_t(i)]));
  order_.close(stayed + count);
}

/// The same where those who stayed are in no order: all are movers.
void Migration::line_up_all(Run const* first, Run const* last, LocalIndex const* movers, LocalIndex count) {
  std::vector<LocalIndex> all(movers, movers + count);
  for_each_group(first, last,
                 [&](LocalIndex n, unsigned stays) { for_each_bit(stays, [&](int i) { all.push_back(n + i); }); });
  came_id_.clear();
  for (LocalIndex place : all) came_id_.push_back(id_at(place));
  sort_by_id({came_id_.data(), all.data()}, LocalIndex(all.size()));
  for (std::size_t i = 0; i < all.size(); ++i) insert(all[i], order_.known() + std::int64_t(i));
  order_.close(LocalIndex(all.size()));
}

/// Let the particle at a place, of the old arrays or among those received, be written as the nth one.
void Migration::insert(LocalIndex place, std::int64_t n) {
  order_.insert(place, n);
  if (place >= particles_.count) arrived_.emplace_back(n, place - LocalIndex(particles_.count));
}

std::vector<std::vector<std::int64_t>> count_per_box(Locator& locator, ParticleView const& particles) {
  std::vector<std::vector<std::int64_t>> out;
  for (int l = 0; l < locator.hierarchy().level_count(); ++l)
    out.emplace_back(std::size_t(locator.hierarchy().level(l).box_count()), 0);
  Home home;
  for (std::int64_t n = 0; n < particles.count; ++n) {
    Real3 x = particles.at(n);
    if (!is_finite(x) || !is_finite(particles.momentum_at(n)) || !locator.wrap(x)) continue;
    home = locator.find(x, home);
    ++out[home.level][home.box];
  }
  return out;
}

}  // namespace amrpic
