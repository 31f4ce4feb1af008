// Octree of boxes of charge, each with its moments about the centre of what it holds.
//
// The leaves are blocks of 8 x 8 x 8 cells of any level; a block of level l lies in one of level l - 1, so refined
// charge only adds depth. Lengths are in units of the smallest base spacing.
#pragma once

#include <vector>

#include "freespace/charge_blocks.hpp"
#include "freespace/lattice_green.hpp"

namespace amrpic::freespace {

struct TreeNode {
  Point centre;      ///< of the bounding box of the charges
  Point half;        ///< half its widths; zero for a single charge
  double radius;     ///< half its diagonal
  double coarsest;   ///< 2^-l of the coarsest level l with charge in it
  double magnitude;  ///< sum of |q|
  LatticeMoments lattice;
  int leaf;  ///< number of the leaf, or -1
  int first_child, children;
};

struct Octree {
  std::vector<TreeNode> nodes;  ///< children of a node are neighbours; the root is the last one
  std::vector<Harmonics<double>> moments;
  std::vector<Expansion> expansions;  ///< the same moments, ready to evaluate

  bool empty() const { return nodes.empty(); }
  int root() const { return int(nodes.size()) - 1; }
};

/// `leaves` are sorted.
Octree build_octree(std::vector<LeafMoments> const& leaves, Point const& shape);

}  // namespace amrpic::freespace
