// The charges of a node of the tree, on so few points that they can be summed one by one.
//
// Across long cells the lattice counts much further than a block of eight short cells is wide. But there the potential
// is smooth from one short cell to the next. So the charges of a wide block are distributed over eight points along
// each of its merged axes, as the potential at ghosts is interpolated from eight points of a patch: with Lagrange's
// weights, and under the same condition on the distance. Along the long axes they stay where they are, and in a node of
// a single block of 8 x 8 x 8 cells all of them do.
#pragma once

#include <map>
#include <memory>
#include <vector>

#include "freespace/interpolation.hpp"
#include "freespace/leaf_charges.hpp"
#include "freespace/octree.hpp"

namespace amrpic::freespace {

static_assert(node_count == block_edge);
constexpr int block_rows = block_edge * block_edge;

/// Points along each axis, among those of a lattice: origin + stride times a whole number.
struct PointsApart {
  Cell stride;
  Point origin;

  double place(int axis, double cell) const { return (cell - origin[axis]) / stride[axis]; }
};

/// Charges on 8 x 8 x 8 points, `points`: by number along each axis; consecutive along the axis of the rows.
struct NodeCharges {
  std::array<Nodes, 3> points;
  BlockCharges values{};
  std::array<unsigned char, block_rows> rows;  ///< those with charge
  int row_count = 0;

  void find_rows();
};

/// Which points charges are wanted on: every `stride`-th one for some ghosts.
struct NodeVariant {
  int node, table, normal, behind, target_level;  ///< of ghosts in the plane `behind` across an axis
  bool operator<(NodeVariant const& o) const;
};

/// Those of all nodes, made when first used.
class ChargesOfNodes {
 public:
  /// `across`: the axes, that of the rows first.
  ChargesOfNodes(Octree const& tree, LeafCharges const& leaves, std::array<int, 3> const& across)
      : tree_(tree), leaves_(leaves), across_(across), made_(tree.nodes.size()) {}

  /// On cells of its level, of which it has that of all its charges.
  NodeCharges const& of(int node);
  /// On points of that level's lattice that are apart.
  NodeCharges const& of(NodeVariant const& variant, PointsApart const& points);

 private:
  std::array<Nodes, 3> points_of(TreeNode const& node, PointsApart const& points) const;

  Octree const& tree_;
  LeafCharges const& leaves_;
  std::array<int, 3> across_;
  std::vector<std::unique_ptr<NodeCharges>> made_;
  std::map<NodeVariant, NodeCharges> variants_;
};

}  // namespace amrpic::freespace
