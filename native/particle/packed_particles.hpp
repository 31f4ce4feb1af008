// Particles on their way to other ranks.
#pragma once

#include <cstdint>
#include <numeric>
#include <vector>

#include "particle/classify.hpp"

namespace amrpic {

/// One particle as it is packed for a message.
struct PackedParticle {
  Real3 position, momentum;
  Real weight;
  std::int64_t id;
  Home home;
  bool wrapped;  ///< it came through a periodic face
};

/// Those to or from all ranks, rank after rank.
struct PackedParticles {
  std::vector<std::int64_t> starts{0};  ///< of each rank; then the end
  std::vector<PackedParticle> all;

  PackedParticles() = default;
  explicit PackedParticles(std::vector<std::int64_t> const& counts) : starts(counts.size() + 1, 0) {
    std::partial_sum(counts.begin(), counts.end(), starts.begin() + 1);
  }
  std::int64_t count() const { return starts.back(); }
  std::int64_t count(std::size_t rank) const { return starts[rank + 1] - starts[rank]; }
};

/// Those that leave this rank, wrapped along periodic axes. Local.
PackedParticles pack(ParticleMesh const& mesh, ParticleView const& particles,
                     std::vector<std::vector<Destinations::Leaver>> const& leavers);

/// Let other ranks know how many will come to them. Return as many as will come here, not received yet. Collective.
PackedParticles announce(Communicator const& comm, PackedParticles const& leaving);

/// Send those that leave, and receive those announced. One message per pair of ranks that has any. Collective.
void exchange(Communicator const& comm, PackedParticles const& leaving, PackedParticles& arrivals);

/// Send rows of so many further numbers of those that leave, and receive those of the ones that arrive. Collective.
void exchange_rows(Communicator const& comm, std::size_t width, PackedParticles const& leaving,
                   std::vector<Real> const& left, PackedParticles const& arrivals, std::vector<Real>& arrived);

}  // namespace amrpic
