#include "particle/migrate.hpp"

#include <mpi.h>

#include <algorithm>
#include <numeric>

namespace amrpic {

namespace {

constexpr int tag_particles = 7201;

bool is_finite(ParticleView const& particles, std::int64_t n) {
  Real product = 0;  // 0 times a finite number is 0, times any other nan
  for (int d = 0; d < 3; ++d) product += 0 * particles.position[d][n] + 0 * particles.momentum[d][n];
  return product == 0;
}

/// Running sums of counts, from zero.
std::vector<std::int64_t> starts_of(std::vector<std::int64_t> const& counts) {
  std::vector<std::int64_t> out(counts.size() + 1, 0);
  std::partial_sum(counts.begin(), counts.end(), out.begin() + 1);
  return out;
}

}  // namespace

Migration::Migration(ParticleMesh& mesh, ParticleView const& particles) : mesh_(mesh), particles_(particles) {
  Hierarchy const& hierarchy = mesh.hierarchy();
  int const ranks = hierarchy.level(0).ranks(), me = hierarchy.level(0).rank();
  slot_.assign(std::size_t(particles.count), -1);
  cell_.resize(std::size_t(particles.count));
  std::vector<std::vector<std::int64_t>> places(static_cast<std::size_t>(ranks));
  std::vector<std::vector<Home>> homes(static_cast<std::size_t>(ranks));
  Home home;
  int owner = me;
  for (std::int64_t n = 0; n < particles.count; ++n) {
    if (!is_finite(particles, n)) {
      not_finite_.push_back(n);
      continue;
    }
    Real3 x = particles.at(n);
    if (!mesh.locator().wrap(x)) {
      lost_.push_back(n);
      continue;
    }
    Home const before = home;
    home = mesh.locator().find(x, before);
    if (home.box != before.box || home.level != before.level) owner = hierarchy.level(home.level).owner(home.box);
    if (owner == me) {
      slot_[n] = mesh.slot(home.level, home.box);
      cell_[n] = home.cell;
      ++staying_;
    } else {
      places[owner].push_back(n);
      homes[owner].push_back(home);
    }
  }

  std::vector<std::int64_t> leaving, coming(std::size_t(ranks), 0);
  for (auto const& p : places) leaving.push_back(std::int64_t(p.size()));
  MPI_Alltoall(leaving.data(), 1, MPI_INT64_T, coming.data(), 1, MPI_INT64_T, hierarchy.comm());
  leaving_start_ = starts_of(leaving);
  received_start_ = starts_of(coming);
  leaving_.resize(std::size_t(leaving_start_.back()));
  for (int r = 0; r < ranks; ++r)
    for (std::size_t i = 0; i < places[r].size(); ++i) pack(places[r][i], homes[r][i], leaving_[leaving_start_[r] + i]);
}

void Migration::pack(std::int64_t n, Home const& home, Parcel& parcel) const {
  Real3 x = particles_.at(n);
  mesh_.locator().wrap(x);
  parcel = {x, particles_.momentum_at(n), particles_.weight[n], particles_.id[n], home.level, home.box, home.cell};
}

void Migration::exchange() {
  MPI_Comm const comm = mesh_.hierarchy().comm();
  int const ranks = mesh_.hierarchy().level(0).ranks();
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
    if (int const n = int(leaving_start_[r + 1] - leaving_start_[r]); n > 0)
      MPI_Isend(leaving_.data() + leaving_start_[r], n, parcel, r, tag_particles, comm, &requests.emplace_back());
  MPI_Waitall(int(requests.size()), requests.data(), MPI_STATUSES_IGNORE);
  MPI_Type_free(&parcel);
}

void Migration::settle_received() {
  for (Parcel const& p : received_) {
    slot_.push_back(mesh_.slot(p.level, p.box));
    cell_.push_back(p.cell);
  }
}

std::vector<std::int64_t> Migration::sorted(std::int64_t* starts) const {
  std::vector<Surroundings> const& boxes = mesh_.boxes();
  std::vector<std::int64_t> count(boxes.size(), 0);
  for (LocalIndex slot : slot_)
    if (slot >= 0) ++count[slot];
  auto const slot_start = starts_of(count);
  std::copy(slot_start.begin(), slot_start.end(), starts);
  std::vector<std::int64_t> by_slot(static_cast<std::size_t>(arriving())), out(by_slot.size());
  auto next = slot_start;
  for (std::size_t n = 0; n < slot_.size(); ++n)
    if (slot_[n] >= 0) by_slot[next[slot_[n]]++] = std::int64_t(n);

  // Within a box by counting as well; ties are few.
  for (std::size_t s = 0; s < boxes.size(); ++s) {
    if (slot_start[s] == slot_start[s + 1]) continue;
    count.assign(std::size_t(mesh_.hierarchy().level(boxes[s].level).box(boxes[s].box).cells()) + 1, 0);
    for (std::int64_t i = slot_start[s]; i < slot_start[s + 1]; ++i) ++count[cell_[by_slot[i]] + 1];
    std::partial_sum(count.begin(), count.end(), count.begin());
    std::int64_t* const first = out.data() + slot_start[s];
    for (std::int64_t i = slot_start[s]; i < slot_start[s + 1]; ++i) first[count[cell_[by_slot[i]]]++] = by_slot[i];
    // Now count[c] is where cell c ends.
    for (std::int64_t c = 0, start = 0; start < slot_start[s + 1] - slot_start[s]; start = count[c++])
      if (count[c] - start > 1)
        std::sort(first + start, first + count[c], [&](std::int64_t a, std::int64_t b) { return id(a) < id(b); });
  }
  return out;
}

void Migration::finish(ParticleView const& out, std::int64_t* starts) {
  exchange();
  settle_received();
  auto const order = sorted(starts);
  for (std::int64_t n = 0; n < arriving(); ++n) {
    Parcel p;
    if (order[n] < particles_.count)
      pack(order[n], {}, p);
    else
      p = received_[order[n] - particles_.count];
    for (int d = 0; d < 3; ++d) out.position[d][n] = p.position[d], out.momentum[d][n] = p.momentum[d];
    out.weight[n] = p.weight;
    out.id[n] = p.id;
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
