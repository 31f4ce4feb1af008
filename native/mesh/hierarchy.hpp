#pragma once

#include <memory>
#include <mutex>
#include <vector>

#include "base/communicator.hpp"
#include "mesh/faces.hpp"

namespace amrpic {

constexpr Index3 refinement_ratio{2, 2, 2};

/// The levels of a refined mesh, coarse to fine; immutable. Which cells are refined does not depend on the number of
/// ranks, nor do boxes where whole ones balance it.
class Hierarchy {
 public:
  /// Cut, order and distribute the boxes of the refined levels (level 0 covers the domain by itself), each level by its
  /// cells (see share_out). Boxes start on multiples of the blocking factor and have a multiple of it, except that
  /// those at the domain's upper faces may be shorter. With boxes of level 0 in `base` these and the refined ones are
  /// taken as they are and in their order, neither cut nor halved: so boxes that were stored come back. Levels
  /// with the boxes of an `earlier` hierarchy on the same domain share them, and are not checked again. Throws
  /// HierarchyError, the same on all ranks, for boxes that overlap, leave the domain, are not aligned so, or do not
  /// nest.
  Hierarchy(Communicator const& comm, Domain const& domain, std::vector<std::vector<Box>> const& refined,
            int max_grid_size, int blocking_factor, std::vector<Box> const& base = {},
            Hierarchy const* earlier = nullptr);

  Communicator const& comm() const { return comm_; }
  Domain const& domain() const { return domain_; }
  int max_grid_size() const { return max_grid_size_; }
  int blocking_factor() const { return blocking_factor_; }
  int level_count() const { return int(levels_.size()); }
  Level const& level(int l) const { return *levels_[l]; }
  std::shared_ptr<Level const> share_level(int l) const { return levels_[l]; }
  bool has_finer(int l) const { return l + 1 < level_count(); }
  /// What lies beyond the faces of this rank's boxes of a level; found at the first call. Local.
  std::shared_ptr<LevelFaces const> share_faces(int l) const;
  LevelFaces const& faces(int l) const { return *share_faces(l); }

  /// The same boxes on the same ranks, in a space whose lengths are those of this one times `factor`.
  std::shared_ptr<Hierarchy const> stretched(Real3 const& factor) const;

  /// The same with open faces across an axis.
  std::shared_ptr<Hierarchy const> opened(int axis) const;

  /// The hierarchy of a virtual rank as another virtual rank of the same number has it. Local.
  std::shared_ptr<Hierarchy const> seen_by(int rank) const;

 private:
  Communicator comm_;
  Domain domain_;
  int max_grid_size_, blocking_factor_;
  std::vector<std::shared_ptr<Level const>> levels_;
  struct Faces {
    std::once_flag found;
    std::vector<std::shared_ptr<LevelFaces const>> levels;
  };
  std::shared_ptr<Faces> faces_ = std::make_shared<Faces>();  ///< a stretched hierarchy shares them
};

/// `region` cut into boxes of at most `max_grid_size` cells per axis that start on multiples of `blocking_factor`. Its
/// last block may be shorter; if it is a single layer of cells, which none would share, it joins the box before it,
/// which may then exceed `max_grid_size` by one. So boxes have at least two cells along each axis, as the region has.
std::vector<Box> cut(Box const& region, int max_grid_size, int blocking_factor);

/// Sort boxes along a space-filling curve: the region that they span is halved once along each axis, the longest first,
/// x last of equal ones, so that few ranks meet, in planes, and few rows are cut; the parts are in Morton order.
void sort_along_curve(std::vector<Box>& boxes);

/// Where each rank's run of boxes starts, ranks + 1 values, so that the runs have about equally many cells.
std::vector<int> distribute(std::vector<Box> const& boxes, int ranks);

/// Sort the boxes of a level along the curve, and return where each rank's run of them starts. Where a rank would have
/// more than 1.1 times the mean of cells, its boxes that lie across the border between the equal parts of two ranks are
/// halved, on blocks, down to 8 cells, and the halves take their place: most boxes stay whole. The same on all ranks,
/// from boxes alone.
std::vector<int> share_out(std::vector<Box>& boxes, int ranks, int blocking_factor);

}  // namespace amrpic
