#include "freespace/wall_patches.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace amrpic::freespace {

Box cells_before(WallMesh const& mesh, GhostBlock const& block) {
  int const axis = block.face / 2;
  auto const axes = plane_axes(axis);
  Box const& domain = mesh.level(block.level).domain();
  Box out = domain.layer(axis, block.face % 2, 0);
  for (int t = 0; t < 2; ++t) {
    out.lower[axes[t]] = block.place[t] * patch_points;
    out.upper[axes[t]] = std::min(domain.upper[axes[t]], out.lower[axes[t]] + patch_points - 1);
  }
  return out;
}

WallPatches::WallPatches(WallMesh const& mesh) {
  for (int l = 0; l < int(mesh.levels.size()); ++l)
    for (Box const& box : mesh.level(l).boxes())
      for_each_ghost_block(mesh, l, box, [&](GhostBlock const& block) { blocks_.push_back(block); });
  std::sort(blocks_.begin(), blocks_.end());
  blocks_.erase(std::unique(blocks_.begin(), blocks_.end()), blocks_.end());
  patches_ = patches_around(mesh.lattice, blocks_);
  Point const shape = mesh.lattice.shape();
  for (GhostPatch const& patch : patches_) boxes_.emplace_back(mesh.lattice.cells, shape, patch);
  find_children();
  share_out(mesh.ranks());
}

int WallPatches::number(GhostBlock const& block) const {
  return int(std::lower_bound(blocks_.begin(), blocks_.end(), block) - blocks_.begin());
}

void WallPatches::find_children() {
  first_child_.assign(patches_.size() + 1, 0);
  for (GhostPatch const& patch : patches_)
    if (patch.parent >= 0) ++first_child_[std::size_t(patch.parent) + 1];
  for (std::size_t p = 0; p < patches_.size(); ++p) first_child_[p + 1] += first_child_[p];
  children_.resize(std::size_t(first_child_.back()));
  auto next = first_child_;
  for (int p = 0; p < count(); ++p) {
    int const parent = patches_[std::size_t(p)].parent;
    if (parent >= 0)
      children_[std::size_t(next[std::size_t(parent)]++)] = p;
    else
      roots_.push_back(p);
  }
}

/// Children lie before their parent, so that most of what is passed down stays where it is, and each rank has wide and
/// narrow patches. As long as there are many, each has several runs of them, from all walls: how much charge is near
/// changes slowly along a wall. If there are few, only some ranks have any: whoever holds a wide block sends it to a
/// quarter of these, and evaluating a patch takes as long as some six messages.
void WallPatches::share_out(int ranks) {
  constexpr std::int64_t shortest = 16, most = 64;
  constexpr double per_patch = 24;  // of those messages, whose number and the work of a rank are least together then
  auto const all = std::int64_t(count());
  std::int64_t const in_use =
      std::clamp(std::int64_t(std::sqrt(per_patch * double(all))), std::int64_t(1), std::int64_t(ranks));
  std::int64_t const runs = in_use * std::clamp(all / (in_use * shortest), std::int64_t(1), most);
  owner_.resize(patches_.size());
  std::int64_t done = 0;
  struct Visit {
    int patch, child;
  };
  std::vector<Visit> stack;
  for (int root : roots_)
    for (stack.push_back({root, first_child(root)}); !stack.empty();) {
      auto& [patch, child] = stack.back();
      if (child < first_child(patch + 1)) {
        int const next = children_[std::size_t(child++)];
        stack.push_back({next, first_child(next)});
      } else {
        owner_[std::size_t(patch)] = int((done++ * runs / all % in_use) * ranks / in_use);
        stack.pop_back();
      }
    }
}

}  // namespace amrpic::freespace
