#include "particle/packed_particles.hpp"

#include <utility>

namespace amrpic {

PackedParticles pack(ParticleMesh const& mesh, ParticleView const& particles,
                     std::vector<std::vector<Destinations::Leaver>> const& leavers) {
  std::vector<std::int64_t> counts;
  for (auto const& to_rank : leavers) counts.push_back(std::int64_t(to_rank.size()));
  PackedParticles out(counts);
  out.all.reserve(std::size_t(out.count()));
  for (auto const& to_rank : leavers)
    for (auto const& [n, home] : to_rank) {
      Real3 const before = particles.at(n);
      Real3 x = before;
      mesh.locator().wrap(x);
      out.all.push_back({x, particles.momentum_at(n), particles.weight_of(n), particles.id[n], home, x != before});
    }
  return out;
}

PackedParticles announce(Communicator const& comm, PackedParticles const& leaving) {
  std::vector<std::pair<int, std::int64_t>> to;
  std::vector<std::int64_t> coming(std::size_t(comm.ranks()), 0);
  for (std::size_t r = 0; r < coming.size(); ++r)
    if (leaving.count(r) > 0) to.emplace_back(int(r), leaving.count(r));
  for (auto const& [rank, count] : comm.announced(to)) coming[std::size_t(rank)] = count;
  return PackedParticles(coming);
}

namespace {

/// Rows of `width` values for each particle.
template <class T>
void exchange_all(Communicator const& comm, std::size_t width, PackedParticles const& leaving,
                  std::vector<T> const& left, PackedParticles const& arrivals, std::vector<T>& arrived) {
  arrived.resize(width * std::size_t(arrivals.count()));
  Messages messages;
  for (int r = 0; r < comm.ranks(); ++r) {
    std::size_t const rank = std::size_t(r);
    if (std::size_t const n = width * std::size_t(arrivals.count(rank)); n > 0)
      messages.receive(comm, arrived.data() + width * std::size_t(arrivals.starts[rank]), n, r);
    if (std::size_t const n = width * std::size_t(leaving.count(rank)); n > 0)
      messages.send(comm, left.data() + width * std::size_t(leaving.starts[rank]), n, r);
  }
  messages.wait_for_all();
}

}  // namespace

void exchange(Communicator const& comm, PackedParticles const& leaving, PackedParticles& arrivals) {
  exchange_all(comm, 1, leaving, leaving.all, arrivals, arrivals.all);
}

void exchange_rows(Communicator const& comm, std::size_t width, PackedParticles const& leaving,
                   std::vector<Real> const& left, PackedParticles const& arrivals, std::vector<Real>& arrived) {
  exchange_all(comm, width, leaving, left, arrivals, arrived);
}

}  // namespace amrpic
