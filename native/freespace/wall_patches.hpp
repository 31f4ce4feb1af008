// The patches of ghosts behind all open walls of a mesh, shared out over the ranks.
#pragma once

#include <array>
#include <memory>
#include <vector>

#include "freespace/ghost_patches.hpp"
#include "freespace/images.hpp"
#include "mesh/level.hpp"

namespace amrpic::freespace {

/// What is known of a mesh and its open walls on every rank.
struct WallMesh {
  Lattice lattice;
  std::array<bool, 6> open;  ///< by face, 2 * axis + side
  std::vector<std::shared_ptr<Level const>> levels;
  int layers = 1;  ///< of ghosts
  Images images{};

  Level const& level(int l) const { return *levels[std::size_t(l)]; }
  int ranks() const { return levels.front()->ranks(); }
};

/// Call f(block) for the blocks of ghosts behind the open walls of a box, of which it has a part.
template <class F>
void for_each_ghost_block(WallMesh const& mesh, int level, Box const& box, F&& f) {
  for (int face = 0; face < 6; ++face) {
    if (!mesh.open[std::size_t(face)] || !mesh.level(level).is_at_wall(box, face / 2, face % 2)) continue;
    auto const [u, v] = plane_axes(face / 2);
    for (int layer = 0; layer < mesh.layers; ++layer)
      for (int j = box.lower[v] / patch_points; j <= box.upper[v] / patch_points; ++j)
        for (int i = box.lower[u] / patch_points; i <= box.upper[u] / patch_points; ++i)
          f(GhostBlock{face, layer, level, {i, j}});
  }
}

/// The cells of a level at the wall before a block of ghosts.
Box cells_before(WallMesh const& mesh, GhostBlock const& block);

/// Those of all ranks, by number: first the blocks, sorted, then what they are joined to, children before parents.
class WallPatches {
 public:
  explicit WallPatches(WallMesh const& mesh);

  int count() const { return int(patches_.size()); }
  GhostPatch const& operator[](int p) const { return patches_[std::size_t(p)]; }
  PatchBox const& box(int p) const { return boxes_[std::size_t(p)]; }
  int owner(int p) const { return owner_[std::size_t(p)]; }
  std::vector<int> const& roots() const { return roots_; }
  /// The children of p are those from first_child[p] to first_child[p + 1] in `children`.
  std::vector<int> const& children() const { return children_; }
  int first_child(int p) const { return first_child_[std::size_t(p)]; }
  std::vector<GhostBlock> const& blocks() const { return blocks_; }
  int number(GhostBlock const& block) const;

 private:
  void find_children();
  void share_out(int ranks);

  std::vector<GhostBlock> blocks_;
  std::vector<GhostPatch> patches_;
  std::vector<PatchBox> boxes_;
  std::vector<int> owner_, roots_, children_, first_child_;
};

}  // namespace amrpic::freespace
