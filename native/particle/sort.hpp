#pragma once

#include <cstdint>
#include <vector>

#include "particle/classify.hpp"
#include "particle/packed_particles.hpp"

namespace amrpic {

/// The place of each particle where it has arrived: by slot and brick, in a brick by the rank and the place where it
/// was, what came through a periodic face behind the others. So the particles of a brick keep their order.
struct Places {
  struct Move {
    LocalIndex from, to;
  };
  std::vector<LocalIndex> runs;       ///< of the first that stayed of each run; the others follow
  std::vector<Move> movers, wrapped;  ///< in order of where they were
  std::vector<LocalIndex> arrivals;   ///< of the first of each portion; the others follow
  std::vector<Home> remote;           ///< remote bricks with particles, ascending: the slots behind those of own boxes
  std::vector<std::int64_t> slots;    ///< where each slot starts, and where the last one ends
};

/// Find the places on this rank of the particles that stay on it, and of those that arrive, some in remote bricks of
/// which none is on it yet: a counting sort. Local.
Places sort(ParticleMesh const& mesh, Destinations& destinations, std::vector<Portion> const& arrivals);

}  // namespace amrpic
