#include "freespace/sight.hpp"

#include <cmath>

#include "freespace/tree_potential.hpp"

namespace amrpic::freespace {

Sight::Sight(WallMesh const& mesh, BlockGrids const& grids, WallPatches const& patches, Options const& options)
    : grids_(grids),
      patches_(patches),
      options_(options),
      lattice_(mesh.lattice),
      shape_(lattice_.shape()),
      images_(mesh.images),
      has_images_(!images_.are_none()),
      finest_(int(mesh.levels.size()) - 1),
      near_cells_(near_cells(lattice_, options)) {
  Cell const widest = widest_blocks(shape_);
  double const longest = longest_spacing(shape_);
  for (int level = 0; level < int(mesh.levels.size()); ++level) {
    LevelReach out{};
    Point half;
    for (int d = 0; d < 3; ++d) {
      half[d] = std::ldexp(0.5 * (widest[d] - 1) * shape_[d], -level);
      if (widest[d] > block_edge) out.half = std::max(out.half, half[d]);
    }
    out.spacing = std::ldexp(longest, -level);
    out.radius = std::hypot(half[0], half[1], half[2]);
    out.limit = margin * far_limit(options, out.radius, out.spacing);
    out.reach = out.limit + out.radius;
    if (out.half > 0) {
      double const narrow = std::sqrt(2.0) * std::max(out.half, 0.5 * patch_points * longest);
      out.merged =
          std::max(far_limit(options, std::max(out.radius, narrow), out.spacing), options.separation * out.half);
    }
    reach_.push_back(out);
  }
}

Sight::BlockBox Sight::box_of(Block const& block) const {
  BlockBox out;
  out.level = grids_[block.grid].level;
  Box const cells = grids_.cells(block);
  for (int d = 0; d < 3; ++d) {
    double const spacing = std::ldexp(shape_[d], -out.level);
    out.centre[d] = 0.5 * (cells.lower[d] + cells.upper[d] + 1) * spacing;
    out.half[d] = 0.5 * cells.extent(d) * spacing - 0.5 * std::ldexp(shape_[d], -finest_);
  }
  out.radius = std::hypot(out.half[0], out.half[1], out.half[2]);
  out.limit = margin * far_limit(options_, out.radius, reach_[std::size_t(out.level)].spacing);
  return out;
}

double Sight::distance2(PatchBox const& box, BlockBox const& b) const {
  if (!has_images_) return box.distance2(b.centre, b.half);
  double out = 0;
  for (int d = 0; d < 3; ++d) {
    double const g = std::max(0.0, images_.apart(d, box.centre[d], b.centre[d]) - box.half[d] - b.half[d]);
    out += g * g;
  }
  return out;
}

bool Sight::is_next_to_centre(int patch, BlockBox const& b) const {
  PatchBox point = patches_.box(patch);
  point.half = {0, 0, 0};
  return distance2(point, b) <= mostly_near2 * b.limit * b.limit;
}

/// Whether nodes in the block may be so wide that a patch opens them rather than leave them to its children.
bool Sight::is_wider(BlockBox const& b, PatchBox const& patch) const {
  return b.radius > patch.radius || reach_[std::size_t(b.level)].half > patch.width;
}

bool Sight::opens_here(int patch, BlockBox const& b) const {
  LevelReach const& there = reach_[std::size_t(b.level)];
  PatchBox const& box = patches_.box(patch);
  double const distance = std::sqrt(distance2(patch, b));
  bool const is_block = patches_[patch].is_block();
  // Charges of a node that is summed one by one lie around its centre, in any block.
  if (distance <= there.reach && (is_block || options_.separation * box.width <= there.limit)) return true;
  return distance <= b.limit && (is_block || is_wider(b, box) || is_next_to_centre(patch, b));
}

/// Nodes of a level or finer ones that a patch leaves to its children are no further away: they are not far or not
/// separated from it, and either not wider than it or a few cells wide.
double Sight::left_within(PatchBox const& patch, int level) const {
  LevelReach const& there = reach_[std::size_t(level)];
  return margin * std::max(far_limit(options_, std::max(there.radius, patch.radius), there.spacing),
                           options_.separation * patch.width);
}

/// Whether the parent of a patch may leave children of the block to it, which it or wider ones have opened.
bool Sight::is_left_by_parent(int patch, BlockBox const& b) const {
  int const parent = patches_[patch].parent;
  if (parent < 0) return false;
  double const limit = left_within(patches_.box(parent), b.level);
  if (distance2(parent, b) > limit * limit) return false;
  if (is_wider(b, patches_.box(parent))) return true;
  for (int wider = parent; wider >= 0; wider = patches_[wider].parent)
    if (is_next_to_centre(wider, b)) return true;
  return false;
}

bool Sight::opens(int patch, Block const& block) const {
  BlockBox const b = box_of(block);
  return opens_here(patch, b) || is_left_by_parent(patch, b);
}

bool Sight::sums(int patch, Block const& leaf) const {
  LevelReach const& there = reach_[std::size_t(grids_[leaf.grid].level)];
  bool const is_narrow = patches_[patch].is_block() || options_.separation * patches_.box(patch).width <= there.limit;
  return is_narrow && is_near_wall(lattice_, near_cells_, {grids_[leaf.grid].level, leaf.place}) &&
         distance2(patch, box_of(leaf)) <= there.reach * there.reach;
}

/// Whether a patch opens a block and all wider ones around it: that is so but for rounding, which must not leave a rank
/// waiting.
bool Sight::opens_all(int patch, Block block) const {
  while (opens(patch, block)) {
    if (grids_[block.grid].parent < 0) return true;
    block = grids_.parent(block);
  }
  return false;
}

}  // namespace amrpic::freespace
