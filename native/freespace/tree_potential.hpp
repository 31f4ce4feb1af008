// The potential of a tree of charges at the ghosts behind walls: multipoles far away, the lattice Green's function
// nearby.
#pragma once

#include <optional>
#include <vector>

#include "base/communicator.hpp"
#include "freespace/ghost_patches.hpp"
#include "freespace/kernel_table.hpp"
#include "freespace/leaves.hpp"
#include "freespace/octree.hpp"

namespace amrpic::freespace {

struct Options {
  double acceptance =
      0.5;  ///< a box is a multipole from where its radius looks smaller than this fraction of the distance
  double lattice_limit = 10;  ///< and from this many of its cells on, where the lattice is a small correction
  double dropped = 1e-7;      ///< fraction of all |q| that may be left out with the weakest boxes
  double separation = 1.25;   ///< charge this many half widths from a patch of ghosts is interpolated on it
};

/// So many cells from a wall, of their level, charges may have to be summed one by one.
Cell near_cells(Lattice const& lattice, Options const& options);

/// Charges as the evaluation needs them.
struct ChargeTree {
  ChargeBlocks blocks;              ///< of this rank
  std::vector<LeafMoments> leaves;  ///< of all ranks, as the tree
  Octree tree;
};

/// Which nodes of the tree count on a patch of ghosts.
struct Interactions {
  struct Far {
    int node;
    int highest;      ///< order that its multipoles need
    bool on_lattice;  ///< whether the lattice counts at this distance
  };
  std::vector<Far> far;    ///< as multipoles at all points
  std::vector<int> mixed;  ///< too near to some of the points for that: charge by charge there

  double cost() const { return double(far.size()) + 4.0 * double(mixed.size()); }
};

class TreePotential {
 public:
  /// For charges of levels up to `finest`.
  TreePotential(Lattice const& lattice, int finest, Options const& options);
  int finest() const { return finest_; }

  /// For each patch; with what it takes from its parent all charge counts just once.
  std::vector<Interactions> interactions(Octree const& tree, std::vector<GhostPatch> const& patches) const;

  /// 4 pi times the potential that its interactions make at the points of each patch first .. last - 1, lengths in
  /// units of the smallest spacing; a value depends on nothing but the tree and its patch. Collective.
  std::vector<double> at(Communicator const& comm, ChargeTree const& charges, std::vector<GhostPatch> const& patches,
                         std::vector<Interactions> const& interactions, std::size_t first, std::size_t last) const;

 private:
  /// A node that is near to some of one row of points.
  struct NearRow {
    std::size_t patch;
    int row;
    unsigned points;  ///< bit t: number t of the row
    int node;
  };
  class NearPatch;
  struct PatchBox;
  double far_limit(TreeNode const& node) const;
  std::optional<double> summed_width(TreeNode const& node) const;
  bool is_summed(TreeNode const& node, PatchBox const& patch_box, double patch_width) const;
  Interactions::Far multipole(Octree const& tree, int node, double distance2) const;
  void add_far(Octree const& tree, std::vector<Interactions::Far> const& nodes, PatchPoints const& points,
               double* values) const;
  void add_mixed(Octree const& tree, std::vector<int> const& nodes, PatchPoints const& points, std::size_t patch,
                 double* values, std::vector<NearRow>& near) const;

  Lattice lattice_;
  int finest_;
  Options options_;
  Point shape_;
  double longest_spacing_;
  Cell widest_;                   ///< blocks of cells of one level
  mutable KernelTables kernels_;  ///< guarded by itself
};

}  // namespace amrpic::freespace
