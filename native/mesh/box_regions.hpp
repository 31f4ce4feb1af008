#pragma once

#include <functional>
#include <vector>

#include "mesh/halo.hpp"

namespace amrpic {

/// Regions of cells as dense arrays, one for each of this rank's boxes, from vectors of own cells and those of others.
///
/// Vectors hold a rank's own cells of a level in its order, components of a cell side by side. Those that regions have
/// of other ranks' are in a halo.
class BoxRegions {
 public:
  /// Box b of `readers` has region(b) of the cells of `owners`, periodic images included, as far as they exist.
  /// near(box): where boxes of `readers` are whose regions may meet such a box of `owners`. Local.
  BoxRegions(Communicator const& comm, Level const& owners, Level const& readers,
             std::function<Box(Box const&)> const& near, std::function<Box(int)> const& region);

  Box const& region(std::size_t part) const { return parts_[part].region; }
  std::size_t halo_size() const { return std::size_t(halo_.size()); }

  /// Call f(place in [own | halo], place in the region, count) for cells of a part that follow each other in both.
  template <class F>
  void for_each_run(std::size_t part, F&& f) const {
    for (Run const& run : parts_[part].runs) f(run.place, run.offset, run.count);
  }
  /// Where a part's cells, x fastest, are in [own | halo].
  std::vector<LocalIndex> places(std::size_t part) const;

  /// The values of a part's cells, x fastest, from [own | halo]; and the same added to those. What the level lacks
  /// stays as it is.
  void read(std::size_t part, int components, Real const* own, Real const* halo, Real* dense) const;
  void add(std::size_t part, int components, Real const* dense, Real* own, Real* halo) const;
  /// The same of one component, zero where the level has no cells.
  ArrayOnBox<Real> values(std::size_t part, Real const* own, std::vector<Real> const& halo) const;

  /// The halo of a vector, from its owners; add a halo to its owners' cells. Collective.
  std::vector<Real> halo(int components, Real const* own) const;
  void fold(int components, Real* own, Real const* halo) const;

 private:
  /// Cells that follow each other in a region and in [own cells | halo], all in one of both.
  struct Run {
    LocalIndex place, offset, count;
  };
  struct Part {
    Box region;
    std::vector<Run> runs;
  };
  std::vector<Run> runs_of(Level const& owners, Box const& region) const;

  Halo halo_;
  std::vector<Part> parts_;
};

}  // namespace amrpic
