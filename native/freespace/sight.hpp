// Which blocks of charge the evaluation of a patch may look into, wherever in them charge is: what follows from boxes
// alone. It holds for all that TreePotential decides once it sees the charge.
#pragma once

#include <vector>

#include "freespace/acceptance.hpp"
#include "freespace/block_grids.hpp"
#include "freespace/wall_patches.hpp"

namespace amrpic::freespace {

class Sight {
 public:
  Sight(WallMesh const& mesh, BlockGrids const& grids, WallPatches const& patches, Options const& options);

  /// Whether a patch may ask for the children of a block, at itself or at a wider patch that leaves some to it. If so,
  /// then also for those of all wider blocks around it.
  bool opens(int patch, Block const& block) const;
  /// Whether it may ask for the charges of a leaf one by one; then it opens the leaf's parent.
  bool sums(int patch, Block const& leaf) const;

  /// Call f(patch) for the patches that open a block, or sum a leaf, until it returns true.
  template <class F>
  void for_each_that_opens(Block const& block, F&& f) const {
    visit(block, [&](int patch) { return opens_all(patch, block) && f(patch); });
  }
  template <class F>
  void for_each_that_sums(Block const& leaf, F&& f) const {
    bool const is_all = grids_[leaf.grid].parent < 0;
    visit(leaf, [&](int patch) {
      return sums(patch, leaf) && (is_all || opens_all(patch, grids_.parent(leaf))) && f(patch);
    });
  }

 private:
  /// A block, whatever charge it holds.
  struct BlockBox {
    Point centre, half;  ///< of the centres of its finest cells
    double limit;        ///< from where on it is a multipole
    double radius;
    int level;
  };
  /// Of charge of one level that is summed one by one.
  struct LevelReach {
    double spacing;  ///< longest
    double limit;    ///< from where its widest blocks are multipoles
    double reach;    ///< charge in them lies no further
    double radius;   ///< of such a block
    double half;     ///< half its width where charges are interpolated over it, or 0
    double merged;   ///< from where patches of less than that width leave blocks to their children
  };
  BlockBox box_of(Block const& block) const;
  /// From the nearest image of a box.
  double distance2(PatchBox const& box, BlockBox const& b) const;
  double distance2(int patch, BlockBox const& b) const { return distance2(patches_.box(patch), b); }
  bool is_next_to_centre(int patch, BlockBox const& b) const;
  bool is_wider(BlockBox const& b, PatchBox const& patch) const;
  bool opens_here(int patch, BlockBox const& b) const;
  bool is_left_by_parent(int patch, BlockBox const& b) const;
  double left_within(PatchBox const& patch, int level) const;
  bool opens_all(int patch, Block block) const;

  /// Call f(patch) for all patches that may be near enough to a block, until it returns true.
  template <class F>
  void visit(Block const& block, F&& f) const {
    struct Visit {
      int patch;
      bool next_to_centre;  ///< of a wider patch around it
    };
    BlockBox const b = box_of(block);
    LevelReach const& there = reach_[std::size_t(b.level)];
    double const near =
        margin * std::max({b.limit, options_.separation * b.radius, there.limit, there.reach, there.merged});
    std::vector<Visit> stack;
    for (int root : patches_.roots()) stack.push_back({root, false});
    while (!stack.empty()) {
      auto [patch, next_to_centre] = stack.back();
      stack.pop_back();
      if (f(patch)) return;
      next_to_centre = next_to_centre || is_next_to_centre(patch, b);
      double const limit = next_to_centre ? std::max(near, margin * left_within(patches_.box(patch), b.level)) : near;
      if (distance2(patch, b) > limit * limit) continue;
      for (int c = patches_.first_child(patch); c < patches_.first_child(patch + 1); ++c)
        stack.push_back({patches_.children()[std::size_t(c)], next_to_centre});
    }
  }

  static constexpr double margin = 1 + 1e-6;  ///< rounding excludes nothing
  BlockGrids const& grids_;
  WallPatches const& patches_;
  Options options_;
  Lattice lattice_;
  Point shape_;
  Images images_;
  bool has_images_;
  int finest_;                     ///< level
  Cell near_cells_;                ///< from a wall, of leaves that are summed
  std::vector<LevelReach> reach_;  ///< by level
};

}  // namespace amrpic::freespace
