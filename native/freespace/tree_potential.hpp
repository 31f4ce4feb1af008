// The potential of a tree of charges at the ghosts behind walls: multipoles far away, the lattice Green's function
// nearby.
#pragma once

#include <functional>
#include <map>
#include <optional>
#include <vector>

#include "freespace/acceptance.hpp"
#include "freespace/ghost_patches.hpp"
#include "freespace/images.hpp"
#include "freespace/kernel_table.hpp"
#include "freespace/lattice_green.hpp"
#include "freespace/leaf_charges.hpp"

namespace amrpic::freespace {

/// So many cells from a wall, of their level, charges may have to be summed one by one.
Cell near_cells(Lattice const& lattice, Options const& options);

/// Charges as the evaluation needs them.
struct Charges {
  Octree const& tree;
  ChargeBlocks const& own;
  std::vector<LeafRecord> const& received;  ///< of other ranks
};

/// Which nodes of the tree count on a patch of ghosts, where an image maps it to.
struct Interactions {
  struct Far {
    int node;
    int highest;      ///< order that its multipoles need
    bool on_lattice;  ///< whether the lattice, or the size of its cells, counts at this distance
  };
  Image image;
  std::vector<Far> far;    ///< as multipoles at all points
  std::vector<int> mixed;  ///< too near to some of the points for that: charge by charge there
};

/// What cells add to the multipoles of a node at some points: as a lattice, and as means over them.
struct OfCells {
  LatticeMoments lattice, means;
  bool has_lattice, has_means;
};

class TreePotential {
 public:
  /// For charges of levels up to `finest`, and images of them if there are any.
  TreePotential(Lattice const& lattice, int finest, bool has_images, Options const& options);
  int finest() const { return finest_; }

  /// Call `use` for each patch that `is_own` with its number and its interactions by image, which with those of its
  /// parents count all charge just once.
  void for_each_patch(Octree const& tree, std::vector<GhostPatch> const& patches, std::vector<char> const& is_own,
                      std::function<void(std::size_t, std::vector<Interactions> const&)> const& use) const;

  /// 4 pi times the potential that its interactions make at the 64 points of each patch that `is_own`, lengths in units
  /// of the smallest spacing; a value depends on nothing but charge and its patch. What closes a lattice counts on the
  /// widest patches.
  std::vector<double> at(Charges const& charges, Closing const& closing, std::vector<GhostPatch> const& patches,
                         std::vector<char> const& is_own) const;

 private:
  class NearPatch;
  double weakness(Octree const& tree, TreeNode const& node) const;
  double far_limit(Octree const& tree, TreeNode const& node) const;
  std::optional<double> summed_width(TreeNode const& node) const;
  bool is_summed(TreeNode const& node, PatchBox const& patch_box) const;
  Interactions::Far multipole(Octree const& tree, int node, double distance2) const;
  OfCells of_cells(Octree const& tree, int node, int level) const;
  void add_far(Octree const& tree, std::vector<Interactions::Far> const& nodes, PatchPoints const& points, int level,
               double* values) const;
  std::map<int, PointMasks> add_mixed(Octree const& tree, std::vector<int> const& nodes, PatchPoints const& points,
                                      int level, double* values) const;

  Lattice lattice_;
  int finest_;
  Options options_;
  Point shape_;
  double longest_spacing_;
  Cell widest_;                   ///< blocks of cells of one level
  mutable KernelTables kernels_;  ///< guarded by itself
};

}  // namespace amrpic::freespace
