#pragma once

#include <vector>

#include "mesh/boundary_cells.hpp"
#include "mesh/halo.hpp"
#include "particle/ghost_cells.hpp"

namespace amrpic {

class BufferZone;
class ParticleMesh;

/// Where gather finds the field in the ghost cells of each box of this rank: the places of a ParticleMesh, for
/// values that are stored in boundary cells alone.
class BoundaryPlaces {
 public:
  /// The ghost cells of one box, as in BoxGhosts; and as in BoxBuffer, for each of its levels.
  struct GhostPlaces {
    GhostCells cells;
    std::vector<LocalIndex> coarse;
    std::vector<std::vector<LocalIndex>> matched;
  };

  /// `zone`: what matched clouds touch as well; null without them.
  BoundaryPlaces(ParticleMesh const& mesh, BufferZone const* zone);

  GhostPlaces const& ghosts(std::size_t slot) const { return ghosts_[slot]; }
  Halo const& halo(int level) const { return halos_[std::size_t(level)]; }
  Halo const& halo_of_matched(int level) const { return of_matched_[std::size_t(level)]; }

 private:
  std::vector<GhostPlaces> ghosts_;
  std::vector<Halo> halos_, of_matched_;
};

}  // namespace amrpic
