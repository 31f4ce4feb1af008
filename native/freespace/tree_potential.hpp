// The potential of a tree of charges at chosen cell centres: multipoles far away, the lattice Green's function nearby.
#pragma once

#include <mpi.h>

#include <vector>

#include "freespace/kernel_table.hpp"
#include "freespace/octree.hpp"

namespace amrpic::freespace {

struct Options {
  double acceptance =
      0.5;  ///< a box is a multipole from where its radius looks smaller than this share of the distance
  double lattice_limit = 10;      ///< and from this many of its cells on, where the lattice is a small correction
  double dropped = 1e-7;          ///< share of all |q| that may be left out with the weakest boxes
  double plane_tolerance = 2e-5;  ///< bound on what interpolation on a wall may add, relative to the greatest potential
};

/// A cell of a level, or a ghost cell: where the potential is asked for.
struct Target {
  Cell cell;
  int level;
};

/// Charges as the evaluation needs them.
struct ChargeTree {
  ChargeBlocks blocks;       ///< of this rank
  std::vector<Leaf> leaves;  ///< of all ranks, as the tree
  Octree tree;
};

class TreePotential {
 public:
  /// For charges of levels up to `finest`.
  TreePotential(Lattice const& lattice, int finest, Options const& options);
  int finest() const { return finest_; }

  /// 4 pi times the potential at each target, lengths in units of the smallest spacing; a value depends on nothing but
  /// the tree and its target. Charges near the targets of any rank come into `near`. Collective.
  std::vector<double> at(MPI_Comm comm, ChargeTree const& charges, std::vector<Target> const& targets,
                         LeafCharges& near) const;

 private:
  struct Pair {
    int target, leaf;
  };
  double far_limit(TreeNode const& node) const;
  std::vector<double> far_field(Octree const& tree, std::vector<Target> const& targets, std::vector<Pair>& near) const;
  double near_field(Leaf const& leaf, double const* charges, Target const& target) const;

  int finest_;
  Options options_;
  Point shape_;
  double longest_spacing_;
  mutable KernelTables kernels_;  ///< guarded by itself
};

}  // namespace amrpic::freespace
