#pragma once

#include <vector>

#include "particle/buffer_zone.hpp"
#include "particle/ghost_plan.hpp"

namespace amrpic {

/// Where gather finds a density whose difference across each cell of a tile it needs: in each box of this rank and
/// around it, one layer further than clouds reach.
class DensityPlaces {
 public:
  static constexpr int reach = tile_reach + 1;

  /// `zone`: what matched clouds touch as well; null without them. Local.
  DensityPlaces(Hierarchy const& hierarchy, BufferZone const* zone);

  BoxGhosts const& box(std::size_t slot) const { return plan_.boxes[slot]; }
  /// Whether all coarser cells exist between which those of a box are interpolated, and no ghost cell lies behind a
  /// wall.
  bool is_whole(std::size_t slot) const { return whole_[slot]; }
  /// For each level of a box's buffer: the places of the cells of its box there, grown by the reach, in [own | halo];
  /// -1: the level has none.
  std::vector<std::vector<LocalIndex>> const& matched(std::size_t slot) const { return matched_[slot]; }
  Halo const& halo(int level) const { return plan_.halos[std::size_t(level)]; }

 private:
  GhostPlan plan_;
  std::vector<char> whole_;
  std::vector<std::vector<std::vector<LocalIndex>>> matched_;
};

}  // namespace amrpic
