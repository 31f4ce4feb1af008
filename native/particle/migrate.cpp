#include "particle/migrate.hpp"

#include <mpi.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <tuple>

#include "particle/id_sort.hpp"

namespace amrpic {

namespace {

constexpr int tag_particles = 7201;

/// Particles that are copied in one go: what they need stays in the first-level cache.
constexpr std::int64_t copy_size = 128;

bool is_finite(ParticleView const& particles, std::int64_t n) {
  Real product = 0;  // 0 times a finite number is 0, times any other nan
  for (int d = 0; d < 3; ++d) product += 0 * particles.position[d][n] + 0 * particles.momentum[d][n];
  return product == 0;
}

/// Copy the values at some places to consecutive ones, past the cache if they are `far`; whether they are finite.
bool permute(Real const* from, LocalIndex const* source, LocalIndex count, Real* to, bool far) {
  LocalIndex const whole = count / lane_count * lane_count;
  Lanes zero{};  // nan as soon as a value is not finite
  if (far) {
    for (LocalIndex i = 0; i < whole; i += lane_count) {
      Lanes const values = pick(from, source + i);
      zero += values - values;
      stream(to + i, values);
    }
  } else {
    for (LocalIndex i = 0; i < whole; i += lane_count) {
      Lanes const values = pick(from, source + i);
      zero += values - values;
      store(to + i, values);
    }
  }
  bool finite = true;
  for (int i = 0; i < lane_count; ++i) finite = finite && zero[i] == 0;
  for (LocalIndex i = whole; i < count; ++i) {
    to[i] = from[source[i]];
    finite = finite && std::isfinite(to[i]);
  }
  return finite;
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
      start_(std::size_t(mesh.first_cell().back()) + 1),
      leaving_(std::size_t(mesh.hierarchy().level(0).ranks())) {
  std::fill(start_.begin(), start_.end(), 0);
  for (std::int64_t n = 0; n < particles.count; n += block_size)
    bin(n, std::min<std::int64_t>(n + block_size, particles.count));
  announce();
}

std::optional<Migration::PlainBox> Migration::plain(Home const& home) const {
  Level const& level = mesh_.hierarchy().level(home.level);
  if (level.owner(home.box) != level.rank() || !mesh_.locator().is_finest(home)) return {};
  Box const& box = level.box(home.box);
  PlainBox out{mesh_.locator().coordinates(home.level), {}, {}, cell_number(home.level, home.box, 0), 0, 0};
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
  return (first + at[0] + stride_y * at[1] + stride_z * at[2]) | ~convert<IndexLanes>(in);
}

/// Find and count the cells of at most `block_size` particles.
void Migration::bin(std::int64_t first, std::int64_t last) {
  LocalIndex* const cell = cell_.data() + first;
  int const count = int(last - first), whole = near_ ? count / lane_count * lane_count : 0;
  for (int i = 0; i < whole; i += lane_count) {
    std::array<Lanes, 3> x;
    for (int d = 0; d < 3; ++d) x[d] = load<Lanes>(particles_.position[d] + first + i);
    store(cell + i, near_->cells(x));
  }
  std::fill(cell + whole, cell + count, -1);
  int astray = 0;
  for (int i = 0; i < count; ++i)
    if (cell[i] < 0) {
      ++astray;
      look_up(first + i);
    } else {
      ++start_[cell[i] + 1];
    }
  staying_ += count - astray;
  if (2 * astray > count && latest_.box >= 0) near_ = plain(latest_);
}

/// Find the home of one particle that does not lie in the box at hand.
void Migration::look_up(std::int64_t n) {
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
    cell_[n] = cell_number(latest_.level, latest_.box, latest_.cell);
    ++start_[cell_[n] + 1];
    ++staying_;
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
  if (particles_.count + received_start_.back() > std::numeric_limits<LocalIndex>::max())
    throw std::length_error("more than 2^31 particles on one rank; use more ranks");
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

/// Make `order_` by counting, and with it the starts of the slots.
void Migration::place(std::int64_t* starts) {
  std::vector<LocalIndex> received_cell;
  for (Parcel const& p : received_) {
    received_cell.push_back(cell_number(p.level, p.box, p.cell));
    ++start_[received_cell.back() + 1];
  }
  auto const& first_cell = mesh_.first_cell();
  LocalIndex sum = 0;
  for (std::size_t s = 0; s + 1 < first_cell.size(); ++s) {
    starts[s] = sum;
    for (LocalIndex c = first_cell[s]; c < first_cell[s + 1]; ++c) {
      LocalIndex const count = start_[c + 1];
      start_[c + 1] = sum;
      sum += count;
    }
  }
  starts[first_cell.size() - 1] = sum;

  order_ = Scratch<LocalIndex>(std::size_t(arriving() + sort_slack));
  for (LocalIndex n = 0; n < particles_.count; ++n)
    if (cell_[n] >= 0) order_[start_[cell_[n] + 1]++] = n;
  for (std::size_t r = 0; r < received_.size(); ++r)
    order_[start_[received_cell[r] + 1]++] = LocalIndex(particles_.count + std::int64_t(r));
}

bool Migration::finish(ParticleView const& out, std::int64_t* starts) {
  exchange();
  place(starts);
  LocalIndex const cells = mesh_.first_cell().back();
  std::int64_t written = 0;
  for (LocalIndex from = 0, to = 0, kept = 0; from < cells; from = to) {  // so many whole cells at a time
    constexpr LocalIndex stride = 16;
    std::int64_t const first = written + kept;
    while (to < cells && start_[std::min(to + stride, cells)] <= first + copy_size) to = std::min(to + stride, cells);
    if (to == from) to = std::min(to + 1, cells);
    prefetch(start_[to], std::min(start_[to] + copy_size, arriving()));
    sort_cells(from, to, kept);
    LocalIndex const ready = LocalIndex(start_[to] - written), whole = ready / lane_count * lane_count;
    LocalIndex const now = to < cells ? whole : ready;
    copy(written, now, out);
    std::copy(id_.begin() + now, id_.begin() + ready, id_.begin());
    std::copy(source_.begin() + now, source_.begin() + ready, source_.begin());
    kept = ready - now;
    written += now;
  }
  stream_end();
  return finite_;
}

/// Ask for the particles that come to places [first, last) to be brought near.
void Migration::prefetch(std::int64_t first, std::int64_t last) const {
  for (std::int64_t n = first; n < last; ++n) {
    LocalIndex const from = order_[n];  // a place beyond the arrays does no harm here
    for (int d = 0; d < 3; ++d) {
      __builtin_prefetch(particles_.position[d] + from);
      __builtin_prefetch(particles_.momentum[d] + from);
    }
    __builtin_prefetch(particles_.weight + from);
    __builtin_prefetch(particles_.id + from);
  }
}

/// Put the particles of cells [from, to) in order of their ids within each cell, behind `kept` of the cells before.
void Migration::sort_cells(LocalIndex from, LocalIndex to, LocalIndex kept) {
  LocalIndex const first = start_[from], count = start_[to] - first;
  LocalIndex* const order = order_.data() + first;
  unsorted_id_.resize(std::size_t(count + sort_slack));
  id_.resize(std::size_t(kept + count + sort_slack));
  source_.resize(std::size_t(kept + count + sort_slack));
  for (LocalIndex i = 0; i < count; ++i)
    unsorted_id_[i] = order[i] < particles_.count ? particles_.id[order[i]] : received_[order[i] - particles_.count].id;
  std::copy(unsorted_id_.begin(), unsorted_id_.end(), id_.begin() + kept);
  std::copy(order, order + count, source_.begin() + kept);
  auto const sort_cell = [&](LocalIndex c) {
    LocalIndex const start = start_[c] - first;
    sort_by_id({unsorted_id_.data() + start, order + start}, start_[c + 1] - start_[c],
               {id_.data() + kept + start, source_.data() + kept + start});
  };
  LocalIndex c = from;
  for (; c + lane_count <= to; c += lane_count)  // often most cells have one particle, or none
    for (auto more = bytes_of(load<IndexLanes>(&start_[c + 1]) - load<IndexLanes>(&start_[c]) > 1); more;) {
      int const lane = __builtin_ctzll(more) / 8;
      sort_cell(c + lane);
      more &= ~(std::uint64_t(255) << (8 * lane));
    }
  for (; c < to; ++c)
    if (start_[c + 1] - start_[c] > 1) sort_cell(c);
}

/// Write `count` particles whose sources are at hand to places from `first`, a multiple of the lanes.
void Migration::copy(std::int64_t first, LocalIndex count, ParticleView const& out) {
  std::vector<std::pair<std::int64_t, Parcel const*>> arrived;
  if (!received_.empty())
    for (LocalIndex i = 0; i < count; ++i)
      if (source_[i] >= particles_.count) {
        arrived.emplace_back(first + i, &received_[source_[i] - particles_.count]);
        source_[i] = 0;  // whatever lies there is overwritten below
      }
  std::copy(id_.begin(), id_.begin() + count, out.id + first);
  if (particles_.count > 0) {
    auto const& [x, p] = std::tie(out.position, out.momentum);
    bool const far = are_far(arriving(), x[0], x[1], x[2], p[0], p[1], p[2], out.weight);
    for (int d = 0; d < 3; ++d) permute(particles_.position[d], source_.data(), count, out.position[d] + first, far);
    for (int d = 0; d < 3; ++d)
      finite_ = permute(particles_.momentum[d], source_.data(), count, out.momentum[d] + first, far) && finite_;
    permute(particles_.weight, source_.data(), count, out.weight + first, far);
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
