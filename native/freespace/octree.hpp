// Octree of boxes of charge, each with its moments about the centre of what it holds: the part of it that this rank
// sees.
//
// Lengths are in units of the smallest base spacing.
#pragma once

#include <cstdint>
#include <vector>

#include "freespace/block_grids.hpp"
#include "freespace/image.hpp"
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
  bool is_shared = false;          ///< whether its children are known on all ranks
  int first_copy = 0, copies = 0;  ///< of a block of images, which has no children

  /// Whether what lies in it is not known on this rank.
  bool is_closed() const { return leaf < 0 && children == 0 && copies == 0; }
};

struct Octree {
  std::vector<TreeNode> nodes;  ///< children of a node are neighbours, behind it; the root is the first one
  std::vector<Harmonics<double>> moments;
  std::vector<Expansion> expansions;  ///< the same moments, ready to evaluate
  /// A node at the places that an image maps to.
  struct Copy {
    int node;
    Image image;
  };
  std::vector<Copy> tops{};     ///< what all begins with
  std::vector<Copy> copies{};   ///< of blocks of images
  std::vector<int> repeated{};  ///< the nodes of which there are lattices

  bool empty() const { return nodes.empty(); }
};

/// A node before it has a place in the tree.
struct Member {
  TreeNode node;
  Harmonics<double> moments;
};

/// As `TreeNode::lattice`, with each charge times one.
LatticeMoments plain_moments(Harmonics<double> const& moments);

/// The node of some children, without these, and their moments about its centre.
Member parent_of(Member const* first, Member const* last);

Member leaf_member(LeafMoments const& part, int number, Point const& shape);

/// The node of a block, as it travels.
struct NodeRecord {
  struct Content {
    Point centre, half;
    double magnitude;
    LatticeMoments lattice;
    Cell first, extent;
    int level;
    std::int16_t depth, is_leaf;  ///< depth: level of its coarsest charge
    std::array<double, moment_count> moments;
  };
  Block block;
  Content content;
};
NodeRecord::Content packed(Member const& member);
/// `leaf`: its number, should it be one.
Member unpacked(NodeRecord::Content const& content, int leaf);

/// The nodes of blocks, joined to those of wider ones grid by grid, and what of the tree is seen.
class OctreeBuilder {
 public:
  /// `own_leaves`: numbers of the leaves of other ranks follow theirs.
  OctreeBuilder(BlockGrids const& grids, std::size_t own_leaves);

  /// A block with charge, and its children in `children_`.
  struct Found {
    Cell place;
    int member;
    int first = 0, last = 0;
  };
  std::vector<Found> const& found(int grid) const { return found_[std::size_t(grid)]; }
  Member const& member(Found const& block) const { return members_[std::size_t(block.member)]; }

  /// The leaves of a level, ascending.
  void add_leaf(int grid, Cell const& place, Member&& member) {
    found_[std::size_t(grid)].push_back({place, keep(std::move(member))});
  }
  /// Give a common node to the children of each block of a grid: those found that `stays` says of, and received ones. A
  /// single child stays what it is.
  template <class Stays>
  void join(int grid, std::vector<NodeRecord> const& received, Stays&& stays) {
    auto& children = children_[std::size_t(grid)];
    for (int from : {grids_[grid].finer, grids_[grid].own}) {
      if (from < 0) continue;
      auto const& blocks = found_[std::size_t(from)];
      for (std::size_t n = 0; n < blocks.size(); ++n) {
        Block const child{from, blocks[n].place};
        if (stays(child)) children.push_back({grids_.parent(child).place, child, blocks[n].member, int(n)});
      }
    }
    for (NodeRecord const& record : received)
      children.push_back({grids_.parent(record.block).place, record.block, keep(record), -1});
    join_sorted(grid);
  }
  /// Make known the nodes of all blocks of a grid, of which this rank has found some.
  void add_found(int grid, std::vector<NodeRecord> const& all);

  /// Append the children of a block that this rank has joined.
  void append_children(int grid, Found const& block, std::vector<NodeRecord>& to) const;

  /// What of the tree is seen: this rank's own blocks and the children of other blocks that were received. `top`: the
  /// grid that is known on all ranks.
  Octree finish(std::vector<NodeRecord> const& received, int top);

 private:
  struct Child {
    Cell parent;
    Block block;
    int member;
    int found;  ///< number among the found blocks of its grid, or -1
  };
  int keep(Member&& member) { return members_.push_back(std::move(member)), int(members_.size()) - 1; }
  int keep(NodeRecord const& record);
  void join_sorted(int grid);
  Member parent_of(Child const* first, Child const* last);
  Found const* find(Block const& block) const;

  BlockGrids const& grids_;
  std::vector<Member> members_, together_;
  std::vector<std::vector<Found>> found_;     ///< by grid, ascending by place
  std::vector<std::vector<Child>> children_;  ///< by grid of the parents, ascending by their place
  int next_leaf_;                             ///< number of the next one of another rank
};

}  // namespace amrpic::freespace
