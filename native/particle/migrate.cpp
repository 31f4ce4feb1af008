#include "particle/migrate.hpp"

#include <mpi.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <tuple>

namespace amrpic {

namespace {

constexpr int tag_particles = 7201;

/// Particles whose columns are written one after the other: their ids and sources stay in the first-level cache.
constexpr std::int64_t copy_size = 512;

/// Values that are collected before they are written.
constexpr LocalIndex collected = 128;

bool is_finite(ParticleView const& particles, std::int64_t n) {
  Real product = 0;  // 0 times a finite number is 0, times any other nan
  for (int d = 0; d < 3; ++d) product += 0 * particles.position[d][n] + 0 * particles.momentum[d][n];
  return product == 0;
}

/// Copy the values at some places to consecutive ones, past the cache if they are `far`, and ask meanwhile for what
/// lies in [ahead.first, ahead.second); whether all are finite.
bool permute(Real const* from, LocalIndex const* source, LocalIndex count, Real* to, bool far,
             std::pair<LocalIndex, LocalIndex> const& ahead) {
  LocalIndex const whole = count / lane_count * lane_count;
  // Spread over the loop: a processor waits for about a dozen lines at a time.
  LocalIndex const stride = ((ahead.second - ahead.first) / std::max(whole, 1) + 1) * lane_count;
  LocalIndex next = ahead.first;
  // Old and new arrays start on pages, and places change little: a load from an old one would often wait for a store to
  // the new one whose address ends in the same twelve bits. So values are collected before they are written.
  alignas(64) Real values[collected];
  Lanes zero{};  // nan as soon as a value is not finite
  for (LocalIndex done = 0; done < whole; done += collected) {
    LocalIndex const part = std::min(whole - done, collected);
    for (LocalIndex i = 0; i < part; i += lane_count) {
      Lanes const eight = pick(from, source + done + i);
      zero += eight - eight;
      store(values + i, eight);
      for (LocalIndex const end = std::min(next + stride, ahead.second); next < end; next += lane_count)
        bring_near(from + next);
    }
    for (LocalIndex i = 0; i < part; i += lane_count)
      if (far)
        stream(to + done + i, load<Lanes>(values + i));
      else
        store(to + done + i, load<Lanes>(values + i));
  }
  bool finite = true;
  for (int i = 0; i < lane_count; ++i) finite = finite && zero[i] == 0;
  for (LocalIndex i = whole; i < count; ++i) {
    to[i] = from[source[i]];
    finite = finite && std::isfinite(to[i]);
  }
  return finite;
}

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
      cell_(std::size_t(particles.count)),
      slots_(mesh.boxes().size()),
      leaving_(std::size_t(mesh.hierarchy().level(0).ranks())) {
  require_few(particles.count);
  for (std::int64_t n = 0; n < particles.count; n += block_size)
    bin(LocalIndex(n), LocalIndex(std::min(n + block_size, particles.count)));
  announce();
}

std::optional<Migration::PlainBox> Migration::plain(Home const& home) const {
  Level const& level = mesh_.hierarchy().level(home.level);
  if (level.owner(home.box) != level.rank() || !mesh_.locator().is_finest(home)) return {};
  Box const& box = level.box(home.box);
  PlainBox out{mesh_.locator().coordinates(home.level), {}, {}, home.level, home.box, 0, 0};
  for (int d = 0; d < 3; ++d) out.lower[d] = box.lower[d], out.upper[d] = box.upper[d] + 1;
  out.stride_y = box.extent(0);
  out.stride_z = box.extent(0) * box.extent(1);
  return out;
}

/// The cells of eight particles that lie in the box, -1 for those that do not.
inline IndexLanes Migration::PlainBox::cells(std::array<Lanes, 3> const& x) const {
  WideLanes in = WideLanes{} - 1;
  Lanes s[3];
  for (int d = 0; d < 3; ++d) {
    s[d] = (x[d] - coordinates.lower[d]) * coordinates.cells_per_metre[d];
    in &= (s[d] >= lower[d]) & (s[d] < upper[d]);
  }
  IndexLanes at[3];  // the differences are exact, so that none is rounded up to the next cell
  for (int d = 0; d < 3; ++d) at[d] = convert<IndexLanes>(in ? s[d] - lower[d] : Lanes{});
  return (at[0] + stride_y * at[1] + stride_z * at[2]) | ~convert<IndexLanes>(in);
}

/// The cell of one particle, -1 if it does not lie in the box.
LocalIndex Migration::PlainBox::cell(Real3 const& x) const {
  Real3 const s = coordinates(x);
  LocalIndex at[3];
  for (int d = 0; d < 3; ++d) {
    if (!(s[d] >= lower[d] && s[d] < upper[d])) return -1;
    at[d] = LocalIndex(s[d] - lower[d]);
  }
  return at[0] + stride_y * at[1] + stride_z * at[2];
}

/// Find the cells of at most `block_size` particles.
void Migration::bin(LocalIndex first, LocalIndex last) {
  LocalIndex* const cell = cell_.data() + first;
  int const count = int(last - first), whole = near_ ? count / lane_count * lane_count : 0;
  IndexLanes astray{};
  for (int i = 0; i < whole; i += lane_count) {
    std::array<Lanes, 3> x;
    for (int d = 0; d < 3; ++d) x[d] = load<Lanes>(particles_.position[d] + first + i);
    IndexLanes const cells = near_->cells(x);
    astray |= cells;  // negative as soon as one is
    store(cell + i, cells);
  }
  std::fill(cell + whole, cell + count, -1);
  LocalIndex stayed = count;
  if (whole < count || bytes_of(astray < 0))
    for (int i = 0; i < count; ++i)
      if (cell[i] < 0) {
        --stayed;
        if (!went_next_door(first + i)) look_up(first + i);
      }
  if (stayed > 0) {
    Slot& slot = slots_[std::size_t(mesh_.slot(near_->level, near_->box))];
    slot.stayed += stayed;
    staying_ += stayed;
    if (!slot.runs.empty() && slot.runs.back().last == first)
      slot.runs.back().last = last;
    else
      slot.runs.push_back({first, last});
  }
  if (2 * stayed < count && latest_.box >= 0) {
    near_ = plain(latest_);
    next_door_.fill({});
  }
}

/// Where a place lies as seen from the box at hand: below, in or above its range along each axis.
int Migration::direction(Real3 const& x) const {
  Real3 const s = near_->coordinates(x);
  int out = 0;
  for (int d = 2; d >= 0; --d) out = 3 * out + (s[d] < near_->lower[d] ? 0 : s[d] < near_->upper[d] ? 1 : 2);
  return out;
}

/// Find the cell of a particle that does not lie in the box at hand, if it lies in a known one around it.
bool Migration::went_next_door(LocalIndex n) {
  if (!near_) return false;
  auto const& box = next_door_[std::size_t(direction(particles_.at(n)))];
  LocalIndex const cell = box ? box->cell(particles_.at(n)) : -1;
  if (cell < 0) return false;
  latest_ = {box->level, box->box, cell};
  move_to(mesh_.slot(box->level, box->box), cell, n);
  return true;
}

void Migration::move_to(int slot, LocalIndex cell, LocalIndex n) {
  cell_[n] = -1;
  slots_[std::size_t(slot)].movers.push_back({cell, n});
  ++staying_;
}

/// Find the home of a particle wherever it lies.
void Migration::look_up(LocalIndex n) {
  cell_[n] = -1;
  if (!is_finite(particles_, n)) {
    finite_ = false;
    return;
  }
  Real3 const before = particles_.at(n);
  Real3 x = before;
  if (!mesh_.locator().wrap(x)) {
    lost_.push_back(n);
    return;
  }
  latest_ = mesh_.locator().find(x, latest_);
  Level const& level = mesh_.hierarchy().level(latest_.level);
  int const owner = level.owner(latest_.box);
  if (owner == level.rank() && x == before) {
    move_to(mesh_.slot(latest_.level, latest_.box), latest_.cell, n);
    if (near_) next_door_[std::size_t(direction(x))] = plain(latest_);
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
          {x, particles_.momentum_at(n), particles_.weight[n], particles_.id[n], home.level, home.box, home.cell});
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
    auto& movers = slots_[std::size_t(mesh_.slot(p.level, p.box))].movers;
    movers.push_back({p.cell, LocalIndex(particles_.count + std::int64_t(r))});
  }
  std::size_t last = 0;  // slot that has any
  starts[0] = 0;
  for (std::size_t s = 0; s < slots_.size(); ++s) {
    starts[s + 1] = starts[s] + slots_[s].stayed + std::int64_t(slots_[s].movers.size());
    if (starts[s] < starts[s + 1]) last = s;
  }
  for (std::size_t s = 0; s < slots_.size(); ++s) {
    if (starts[s] == starts[s + 1]) continue;
    LocalIndex const cells = mesh_.first_cell()[s + 1] - mesh_.first_cell()[s];
    count_by_cell(slots_[s], cells);
    place(slots_[s], cells);
    write_box(slots_[s], cells, s == last, out);
    slots_[s] = {};
  }
  stream_end();
  return finite_;
}

/// Let value c + 1 of `count_` be how many particles cell c of the box has; the first one counts who does not stay.
void Migration::count_by_cell(Slot const& slot, LocalIndex cells) {
  count_.assign(std::size_t(cells) + 1, 0);
  LocalIndex* const count = count_.data() + 1;
  for (Run const& run : slot.runs)
    for (LocalIndex n = run.first; n < run.last; ++n) ++count[cell_[n]];
  for (Mover const& mover : slot.movers) ++count[mover.cell];
}

/// Sort the places of a box's particles into `order_` by cell, and let value c of `count_` be where cell c starts.
void Migration::place(Slot const& slot, LocalIndex cells) {
  LocalIndex const gone = count_[0], total = slot.stayed + LocalIndex(slot.movers.size());
  LocalIndex sum = 0;
  for (LocalIndex c = 1; c <= cells; ++c) {
    LocalIndex const count = count_[c];
    count_[c] = sum;
    sum += count;
  }
  count_[0] = total;  // who does not stay goes behind the others
  order_.resize(std::max(order_.size(), std::size_t(total + gone + sort_slack)));
  LocalIndex *const next = count_.data() + 1, *const order = order_.data();
  for (Run const& run : slot.runs)
    for (LocalIndex n = run.first; n < run.last; ++n) order[next[cell_[n]]++] = n;
  for (Mover const& mover : slot.movers) order[next[mover.cell]++] = mover.place;
  count_[0] = 0;  // each of the others has become the start of the cell after
  near_to_ = slot.runs.empty() ? 0 : slot.runs.front().first;
}

/// Write the particles of a box but for those that do not fill a vector, which are left to the next one.
void Migration::write_box(Slot const& slot, LocalIndex cells, bool last_of_all, ParticleView const& out) {
  for (LocalIndex from = 0, to = 0; from < cells; from = to) {  // so many whole cells at a time
    constexpr LocalIndex stride = 16;
    LocalIndex const enough = count_[from] + copy_size;
    while (to < cells && count_[std::min(to + stride, cells)] <= enough) to = std::min(to + stride, cells);
    if (to == from) to = std::min(to + 1, cells);
    sort_cells(from, to);
    LocalIndex const ready = kept_ + count_[to] - count_[from];
    LocalIndex const now = last_of_all && to == cells ? ready : ready / lane_count * lane_count;
    copy(now, wanted(slot, count_[to], std::min(count_[to] + LocalIndex(copy_size), count_[cells])), out);
    std::copy(id_.begin() + now, id_.begin() + ready, id_.begin());
    std::copy(source_.begin() + now, source_.begin() + ready, source_.begin());
    kept_ = ready - now;
    written_ += now;
  }
}

/// What to ask for in the old arrays, as particles come from there to places [first, last) of the box. Nearly sorted as
/// those who stay are, they are wanted nearly in order; so each line is asked for once.
std::pair<LocalIndex, LocalIndex> Migration::wanted(Slot const& slot, LocalIndex first, LocalIndex last) {
  if (slot.runs.empty()) return {0, 0};
  LocalIndex const end = slot.runs.back().last;
  LocalIndex furthest = near_to_;
  for (LocalIndex n = first; n < last; ++n) furthest = std::max(furthest, order_[n] < end ? order_[n] + 1 : 0);
  constexpr LocalIndex most = 1 << 14;  // who comes from further ahead stands alone
  LocalIndex const start = std::max(near_to_, furthest - most);
  near_to_ = (furthest + lane_count - 1) / lane_count * lane_count;
  return {start, near_to_};
}

/// Put the particles of cells [from, to) in order of their ids within each cell, behind those that are left over.
void Migration::sort_cells(LocalIndex from, LocalIndex to) {
  LocalIndex const first = count_[from], count = count_[to] - first;
  std::size_t const room = std::size_t(kept_ + count + sort_slack);
  if (id_.size() < room) id_.resize(2 * room), source_.resize(2 * room);
  Keyed const at{id_.data() + kept_, source_.data() + kept_};
  std::copy(order_.data() + first, order_.data() + first + count, at.value);
  read_ids(at, count);
  LocalIndex const* const start = count_.data();
  auto const sort_cell = [&](LocalIndex c) {
    sort_by_id({at.id + start[c] - first, at.value + start[c] - first}, start[c + 1] - start[c]);
  };
  LocalIndex c = from;
  for (; c + lane_count <= to; c += lane_count)  // often most cells have one particle, or none
    for (auto more = bytes_of(load<IndexLanes>(start + c + 1) - load<IndexLanes>(start + c) > 1); more;) {
      int const lane = __builtin_ctzll(more) / 8;
      sort_cell(c + lane);
      more &= ~(std::uint64_t(255) << (8 * lane));
    }
  for (; c < to; ++c)
    if (start[c + 1] - start[c] > 1) sort_cell(c);
}

void Migration::read_ids(Keyed const& at, LocalIndex count) const {
  std::int64_t const* const id = particles_.id;
  if (received_.empty())
    for (LocalIndex i = 0; i < count; ++i) at.id[i] = id[at.value[i]];
  else
    for (LocalIndex i = 0; i < count; ++i) {
      std::int64_t const beyond = at.value[i] - particles_.count;
      at.id[i] = beyond < 0 ? id[at.value[i]] : received_[std::size_t(beyond)].id;
    }
}

/// Write the first `count` particles whose sources are at hand, and ask for others `ahead`.
void Migration::copy(LocalIndex count, std::pair<LocalIndex, LocalIndex> const& ahead, ParticleView const& out) {
  std::int64_t const first = written_;
  std::vector<std::pair<std::int64_t, Parcel const*>> arrived;
  if (!received_.empty())
    for (LocalIndex i = 0; i < count; ++i)
      if (source_[i] >= particles_.count) {
        arrived.emplace_back(first + i, &received_[source_[i] - particles_.count]);
        source_[i] = 0;  // whatever lies there is overwritten below
      }
  std::copy(id_.begin(), id_.begin() + count, out.id + first);
  for (LocalIndex n = ahead.first; n < ahead.second; n += lane_count) bring_near(particles_.id + n);
  if (particles_.count > 0) {
    auto const& [x, p] = std::tie(out.position, out.momentum);
    bool const far = are_far(arriving(), x[0], x[1], x[2], p[0], p[1], p[2], out.weight);
    auto const write = [&](Real const* from, Real* to) {
      return permute(from, source_.data(), count, to + first, far, ahead);
    };
    for (int d = 0; d < 3; ++d) write(particles_.position[d], out.position[d]);
    for (int d = 0; d < 3; ++d) finite_ = write(particles_.momentum[d], out.momentum[d]) && finite_;
    write(particles_.weight, out.weight);
  }
  for (auto const& [n, parcel] : arrived) {
    for (int d = 0; d < 3; ++d) out.position[d][n] = parcel->position[d], out.momentum[d][n] = parcel->momentum[d];
    out.weight[n] = parcel->weight;
  }
}

std::vector<std::vector<std::int64_t>> count_per_box(Locator& locator, ParticleView const& particles) {
  std::vector<std::vector<std::int64_t>> out;
  for (int l = 0; l < locator.hierarchy().level_count(); ++l)
    out.emplace_back(std::size_t(locator.hierarchy().level(l).box_count()), 0);
  Home home;
  for (std::int64_t n = 0; n < particles.count; ++n) {
    Real3 x = particles.at(n);
    if (!is_finite(particles, n) || !locator.wrap(x)) continue;
    home = locator.find(x, home);
    ++out[home.level][home.box];
  }
  return out;
}

}  // namespace amrpic
