// Particles that are with their servers already, but not sorted there.
#pragma once

#include <vector>

#include "particle/particle_mesh.hpp"
#include "particle/servers.hpp"
#include "particle/view.hpp"

namespace amrpic {

/// Where `Migration` would put particles of which none leaves this rank: its caller moves them, one column at a time if
/// there is no memory for two copies of all.
struct Arrangement {
  std::vector<LocalIndex> places;    ///< of each particle
  std::vector<std::int64_t> starts;  ///< of each slot, and of one more
  std::vector<Home> remote;          ///< bricks of the last slots
  std::vector<int> first_servers;    ///< of these
};

/// Find the places of particles of which this rank is the server; only positions and ids are read. Throws
/// std::invalid_argument if some are outside the domain or another rank serves them. Local.
Arrangement arrange(ParticleMesh& mesh, Servers const& servers, ParticleView const& particles);

}  // namespace amrpic
