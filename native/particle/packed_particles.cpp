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

void exchange(Communicator const& comm, PackedParticles const& leaving, PackedParticles& arrivals) {
  arrivals.all.resize(std::size_t(arrivals.count()));
  Messages messages;
  for (int r = 0; r < comm.ranks(); ++r) {
    std::size_t const rank = std::size_t(r);
    if (std::int64_t const n = arrivals.count(rank); n > 0)
      messages.receive(comm, arrivals.all.data() + arrivals.starts[rank], std::size_t(n), r);
    if (std::int64_t const n = leaving.count(rank); n > 0)
      messages.send(comm, leaving.all.data() + leaving.starts[rank], std::size_t(n), r);
  }
  messages.wait_for_all();
}

}  // namespace amrpic
