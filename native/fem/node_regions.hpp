#pragma once

#include <functional>
#include <memory>
#include <vector>

#include "mesh/halo.hpp"

namespace amrpic::fem {

/// Regions of nodes as dense arrays, one for each of this rank's boxes, from vectors of own nodes and those of others.
///
/// Nodes are the cells of a level, and vectors hold a rank's own ones in its order, components of a node side by side.
/// Those that regions have of other ranks' are in a halo.
class NodeRegions {
 public:
  /// Box b of `readers` has region(b) of the nodes of `owners`, cut to what there is. near(box): where boxes of
  /// `readers` are whose regions may meet such a box of `owners`. Local.
  NodeRegions(Communicator const& comm, Level const& owners, Level const& readers,
              std::function<Box(Box const&)> const& near, std::function<Box(int)> const& region);

  Box const& region(std::size_t part) const { return parts_[part].region; }
  std::size_t halo_size() const { return std::size_t(halo_.size()); }

  /// Where a part's nodes, x fastest, are in [own | halo].
  std::vector<LocalIndex> places(std::size_t part) const;

  /// The values of a part's nodes, x fastest, from [own | halo]; and the same added to those.
  void read(std::size_t part, int components, Real const* own, Real const* halo, Real* dense) const;
  void add(std::size_t part, int components, Real const* dense, Real* own, Real* halo) const;

  /// Fill the halo of a vector from its owners; add a halo to its owners' nodes. Collective.
  void update(int components, Real const* own, Real* halo) const;
  void fold(int components, Real* own, Real const* halo) const;

 private:
  /// Nodes that follow each other in a region and in [own nodes | halo], all in one of both.
  struct Run {
    LocalIndex place, offset, count;
  };
  struct Part {
    Box region;
    std::vector<Run> runs;
  };
  std::vector<Run> runs_of(std::vector<LocalIndex> const& places) const;

  LocalIndex owned_;
  Halo halo_;
  std::vector<Part> parts_;
};

}  // namespace amrpic::fem
