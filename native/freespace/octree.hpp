// Octree of boxes of charge, each with its moments about the centre of what it holds.
//
// The leaves are blocks of 8 x 8 x 8 cells of any level. Where cells are long, those of a level are merged across them
// first, until blocks are about as wide as long. Such a block of level l lies in one of level l - 1, so refined charge
// only adds depth. Lengths are in units of the smallest base spacing.
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
  int level;           ///< of all its charges, or -1
  Cell first, extent;  ///< then, bounding box of the charged cells of that level
  int leaf;            ///< number of the leaf, or -1
  int first_child, children;
};

struct Octree {
  std::vector<TreeNode> nodes;  ///< children of a node are neighbours; the root is the last one
  std::vector<Harmonics<double>> moments;
  std::vector<Expansion> expansions;  ///< the same moments, ready to evaluate

  bool empty() const { return nodes.empty(); }
  int root() const { return int(nodes.size()) - 1; }
};

/// Cells of a level along each axis of its widest blocks: 8 x 8 x 8 where cells are about cubes. Where they are not, as
/// many times more across the long ones as make the blocks about as wide as long.
Cell widest_blocks(Point const& shape);

/// `leaves` are sorted.
Octree build_octree(std::vector<LeafMoments> const& leaves, Point const& shape);

}  // namespace amrpic::freespace
