#pragma once

#include <vector>

#include "particle/buffer_zone.hpp"
#include "particle/ghost_plan.hpp"

namespace amrpic {

/// Cells of a level whose values follow each other along x, and lie at equal distances along y and z.
struct CellBlock {
  Box cells;
  LocalIndex place;  ///< of the first one in [own | halo] of the level; -1: the level has none of these cells
  Index3 stride;     ///< between places; of no meaning along an axis with one cell

  LocalIndex row(int j, int k) const {
    return place + stride[1] * (j - cells.lower[1]) + stride[2] * (k - cells.lower[2]);
  }
};

/// Where gather finds a density whose difference across each cell of a tile it needs: in each box of this rank and
/// around it, one layer further than clouds reach.
class DensityPlaces {
 public:
  static constexpr int reach = tile_reach + 1;

  struct OfBox {
    int level, box;
    std::vector<CellBlock> ghosts;  ///< ascending along z
    Box parents;                    ///< as in BoxGhosts
    struct CoarseRow {
      LocalIndex number, place, count;  ///< of the first one in `parents`, and in [own | halo] of the coarser level
    };
    std::vector<CoarseRow> coarse;  ///< those between which ghost cells are interpolated, as far as they exist
    bool whole;                     ///< whether all of these exist, none behind a wall

    /// Call f(block) for the ghost cells in plane k.
    template <class F>
    void for_each_ghost_block(int k, F&& f) const {
      for (CellBlock const& block : ghosts) {
        if (block.cells.lower[2] > k) return;
        if (block.cells.upper[2] >= k) f(block);
      }
    }
  };

  /// `zone`: what matched clouds touch as well; null without them. Local.
  DensityPlaces(Hierarchy const& hierarchy, BufferZone const* zone);

  OfBox const& box(std::size_t slot) const { return boxes_[slot]; }
  /// For each level of a box's buffer: the places of the cells of its box there, grown by the reach, in [own | halo];
  /// -1: the level has none.
  std::vector<std::vector<LocalIndex>> const& matched(std::size_t slot) const { return matched_[slot]; }
  Halo const& halo(int level) const { return halos_[std::size_t(level)]; }

 private:
  std::vector<OfBox> boxes_;
  std::vector<Halo> halos_;
  std::vector<std::vector<std::vector<LocalIndex>>> matched_;
};

}  // namespace amrpic
