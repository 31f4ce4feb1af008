// The layers of ghost centres behind the walls, cut into a quadtree of patches.
//
// The potential of charge far away is smooth: over a patch it is the polynomial through 8 x 8 of its ghosts. So each
// box of charge is evaluated on the largest patches that it is far enough from, and what is found there is passed down
// to the smallest ones, of which the points are all ghosts.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <vector>

#include "freespace/image.hpp"
#include "freespace/interpolation.hpp"

namespace amrpic::freespace {

constexpr int patch_points = node_count;                   ///< along an axis
constexpr int patch_values = patch_points * patch_points;  ///< lower axis fastest

/// Which points of a patch: bit t of number `row` stands for point t of that row.
using PointMasks = std::array<std::uint8_t, patch_points>;
static_assert(patch_points <= 8);

/// Axes of the plane, in ascending order.
constexpr std::array<int, 2> plane_axes(int normal) { return {normal == 0 ? 1 : 0, normal == 2 ? 1 : 2}; }

/// Ghosts 8 place .. 8 place + 7 of a level behind a wall; those outside the wall are computed in vain.
struct GhostBlock {
  int face;   ///< 2 * axis + side
  int layer;  ///< 0: next to the wall
  int level;
  std::array<int, 2> place;
  bool operator==(GhostBlock const& o) const;
  bool operator<(GhostBlock const& o) const;
};

/// Ghosts first .. first + extent - 1 of a level behind a wall.
struct GhostPatch {
  int face, layer, level;
  std::array<int, 2> first, extent;  ///< extents: 8, 16, 32, ...
  int parent;                        ///< or -1

  /// Cell of the level along the normal, `cells` of which lie between the walls.
  int behind(int cells) const { return face % 2 == 0 ? -1 - layer : cells + layer; }
  bool is_block() const { return extent[0] == patch_points && extent[1] == patch_points; }
};

/// The blocks and all their ancestors, children before parents: first the blocks, in their order. `blocks` are
/// sorted.
std::vector<GhostPatch> patches_around(Lattice const& lattice, std::vector<GhostBlock> const& blocks);

/// The ghosts of a patch as a box, flat along the normal; smallest base spacing = 1.
struct PatchBox {
  PatchBox(Cell const& cells, Point const& shape, GhostPatch const& patch);  ///< of the base lattice
  PatchBox seen_by(Image const& image, Point const& shape) const;

  Point centre, half;
  double radius;     ///< half its diagonal
  double width = 0;  ///< half of it, of what is interpolated over

  /// Squared distance from another box.
  double distance2(Point const& there, Point const& half_there) const {
    double out = 0;
    for (int d = 0; d < 3; ++d) {
      double const g = std::max(0.0, std::abs(centre[d] - there[d]) - half[d] - half_there[d]);
      out += g * g;
    }
    return out;
  }
};

/// Where an image maps the points of a patch to.
struct PatchPoints {
  PatchPoints(Lattice const& lattice, GhostPatch const& patch, Image const& image = {});

  int normal;
  double place;                                           ///< along the normal
  std::array<std::array<double, patch_points>, 2> along;  ///< along the axes of the plane
  PatchBox box;
};

/// Adds to the values of patches what those of their parents are there.
class PatchInterpolation {
 public:
  /// 64 values of each.
  void add(GhostPatch const& parent, double const* values, GhostPatch const& child, double* to);

 private:
  /// Row i: weights of the points of the parent for point i of the child.
  using Weights = std::array<std::array<double, patch_points>, patch_points>;
  Weights const& weights(int parent_extent, int extent, int offset);

  std::map<std::array<int, 3>, Weights> made_;  ///< there are few
};

}  // namespace amrpic::freespace
