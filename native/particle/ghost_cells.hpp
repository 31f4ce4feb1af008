#pragma once

#include <vector>

#include "particle/geometry.hpp"

namespace amrpic {

/// Ghost cells of a box that follow each other along x or y, at equal distances in memory.
struct GhostRun {
  Index3 first;
  int axis;
  LocalIndex count;
  /// In [own | halo] of the level, all of them in one of both; -1: the level has no such cells.
  LocalIndex place, place_stride;
  LocalIndex number, number_stride;  ///< among the box's ghost cells, in the order of `for_each_ghost_row`

  Index3 cell(LocalIndex n) const {
    Index3 out = first;
    out[std::size_t(axis)] += n;
    return out;
  }
};

/// The ghost cells of a box, which its particles touch, as runs.
class GhostCells {
 public:
  GhostCells() = default;
  /// `places` of all its cells, of as many layers as `reach` says, in the order of `for_each_ghost_row`, in
  /// [own | halo], `owned` of which are own; negative where the level has none.
  GhostCells(Box const& box, std::vector<LocalIndex> const& places, LocalIndex owned, int reach = tile_reach);

  /// The same cells where the values at `places` are kept elsewhere: place(one of those), `owned` of them own.
  template <class Place>
  GhostCells kept_elsewhere(Box const& box, LocalIndex owned, Place const& place) const {
    std::vector<LocalIndex> places(cells_, -1);
    for (GhostRun const& run : runs_)
      for (LocalIndex n = 0; run.place >= 0 && n < run.count; ++n)
        places[std::size_t(run.number + n * run.number_stride)] = place(run.place + n * run.place_stride);
    return GhostCells(box, places, owned, box.lower[2] - first_plane_);
  }

  std::size_t cells() const { return cells_; }
  std::vector<GhostRun> const& runs() const { return runs_; }

  /// Call f(run) for those in plane k.
  template <class F>
  void for_each_run(int k, F&& f) const {
    std::size_t const plane = std::size_t(k - first_plane_);
    for (std::size_t n = plane_start_[plane]; n < plane_start_[plane + 1]; ++n) f(runs_[n]);
  }

 private:
  std::size_t cells_ = 0;
  int first_plane_ = 0;
  std::vector<GhostRun> runs_;
  std::vector<std::size_t> plane_start_;
};

}  // namespace amrpic
