#include "freespace/wall_counts.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <set>

#include "freespace/tree_potential.hpp"

namespace amrpic::freespace {

namespace {

/// Full blocks in place of what is received.
class FullBlocks {
 public:
  FullBlocks(WallGeometry const& geometry, std::vector<ChargedRegion> const& charged)
      : geometry_(geometry), charged_(charged), shape_(geometry.mesh.lattice.shape()) {}

  bool has_charge(Block const& block) const {
    if (geometry_.home(block) < 0) return false;
    int const level = geometry_.grids[block.grid].level;
    Box const cells = geometry_.grids.cells(block);
    bool const is_near = charged_.empty() || std::any_of(charged_.begin(), charged_.end(), [&](auto const& region) {
                           bool meets = true;
                           for (int d = 0; d < 3; ++d)
                             meets = meets && std::ldexp(cells.lower[d], -level) < region.upper[d] &&
                                     std::ldexp(cells.upper[d] + 1, -level) > region.lower[d];
                           return meets;
                         });
    if (!is_near) return false;
    if (geometry_.grids[block.grid].is_leaf()) return !is_covered(level, cells);
    bool any = false;
    geometry_.grids.for_each_child(block, [&](Block const& child) { any = any || has_charge(child); });
    return any;
  }
  std::vector<Block> charged(std::vector<Block> const& blocks) const {
    std::vector<Block> out;
    std::copy_if(blocks.begin(), blocks.end(), std::back_inserter(out), [&](Block const& b) { return has_charge(b); });
    return out;
  }
  std::vector<NodeRecord> children(Block const& block) const {
    std::vector<NodeRecord> out;
    for (Block const& child : charged_children(block)) out.push_back(record(child));
    return out;
  }
  NodeRecord record(Block const& of) const {
    Block block = of;
    for (auto children = charged_children(block); children.size() == 1; children = charged_children(block))
      block = children.front();  // the same node
    int const level = geometry_.grids[block.grid].level;
    Box const cells = geometry_.grids.cells(block);
    NodeRecord out{of, {}};
    for (int d = 0; d < 3; ++d) {
      double const spacing = std::ldexp(shape_[d], -level);
      out.content.centre[d] = 0.5 * (cells.lower[d] + cells.upper[d] + 1) * spacing;
      out.content.half[d] = 0.5 * (cells.extent(d) - 1) * spacing;
      out.content.extent[d] = cells.extent(d);
    }
    out.content.magnitude = 1;
    out.content.lattice.charge = 1;
    out.content.first = cells.lower;
    out.content.level = holds_finer(block.grid) && meets_finer(level, cells) ? -1 : level;
    out.content.depth = std::int16_t(level);
    out.content.is_leaf = geometry_.grids[block.grid].is_leaf();
    out.content.moments[0] = 1;
    return out;
  }

 private:
  std::vector<Block> charged_children(Block const& block) const {
    std::vector<Block> out;
    geometry_.grids.for_each_child(block, [&](Block const& child) {
      if (has_charge(child)) out.push_back(child);
    });
    return out;
  }
  bool holds_finer(int grid) const {
    for (; grid >= 0; grid = geometry_.grids[grid].own)
      if (geometry_.grids[grid].finer >= 0) return true;
    return false;
  }
  bool meets_finer(int level, Box const& cells) const {
    return std::size_t(level) + 1 < geometry_.mesh.levels.size() &&
           geometry_.mesh.level(level + 1).intersects(cells.refine({2, 2, 2}));
  }
  bool is_covered(int level, Box const& cells) const {
    if (!meets_finer(level, cells)) return false;
    Box const finer = cells.refine({2, 2, 2});
    GlobalIndex covered = 0;
    geometry_.mesh.level(level + 1).for_each_overlap(
        finer, [&](int, Box const& part, Index3 const&) { covered += part.cells(); });
    return covered == finer.cells();
  }

  WallGeometry const& geometry_;
  std::vector<ChargedRegion> const& charged_;
  Point shape_;
};

WallCounts::Sent sent(std::vector<Parcel> const& parcels) {
  WallCounts::Sent out;
  int last = -1;
  for (Parcel const& parcel : parcels) {
    if (parcel.rank != last) ++out.messages;
    last = parcel.rank;
    out.bytes += parcel.values * std::int64_t(sizeof(double));
  }
  return out;
}

WallCounts::Sent operator+(WallCounts::Sent const& a, WallCounts::Sent const& b) {
  return {a.messages + b.messages, a.bytes + b.bytes};
}

std::int64_t bytes_of(std::size_t nodes) { return std::int64_t(nodes * sizeof(NodeRecord::Content)); }

template <class T>
std::int64_t count_of(T const& list) {
  return std::int64_t(list.size());
}

}  // namespace

WallCounts count(WallPlan const& plan, Options const& options, std::vector<ChargedRegion> const& charged) {
  WallGeometry const& geometry = plan.geometry();
  BlockGrids const& grids = geometry.grids;
  FullBlocks const full(geometry, charged);
  WallCounts out;
  if (geometry.by_axes) {
    std::int64_t cells = 0;
    for (auto const& level : geometry.mesh.levels) cells += level->cells();
    if (geometry.mesh.ranks() > 1) out.collectives = {std::int64_t(sizeof(double)) * cells};
    return out;
  }
  out.patches = std::count(plan.is_own.begin(), plan.is_own.end(), char(1));

  std::vector<Parcel> parts_out, parts_in;
  for (LeafPart const& part : plan.parts_out) parts_out.push_back({part.rank, part.cells.cells()});
  for (LeafPart const& part : plan.parts_in) parts_in.push_back({part.rank, part.cells.cells()});
  out.parts = sent(parts_out);
  out.received_messages = sent(parts_in).messages;
  for (std::size_t grid = 0; grid < plan.joins.size(); ++grid) {
    out.joins.messages += count_of(plan.joins[grid].to);
    out.received_messages += count_of(plan.joins[grid].from);
    for (Gift const& gift : plan.upwards[grid])
      if (full.has_charge(gift.block)) out.joins.bytes += std::int64_t(sizeof(NodeRecord));
  }
  if (geometry.mesh.ranks() > 1)
    out.collectives = {std::int64_t(sizeof(double)) * (octaves + most_levels), bytes_of(geometry.top_blocks().size())};
  int below = 0;
  std::vector<Block> known = full.charged(geometry.top_blocks());
  for (auto children = geometry.shared_children(known); !children.empty(); children = geometry.shared_children(known)) {
    out.collectives.push_back(bytes_of(children.size()));
    known = full.charged(children);
    ++below;
  }
  Senders const family_ranks = plan.family_ranks_below(known, below);
  out.families.messages = count_of(family_ranks.to);
  for (std::size_t n = 0; n < plan.families.size();) {
    Block const block = plan.families[n].block;
    std::size_t const first = n;
    while (n < plan.families.size() && plan.families[n].block == block) ++n;
    if (geometry.below_top(block.grid) < below) continue;
    std::int64_t const children = full.has_charge(block) ? count_of(full.children(block)) : 0;
    out.families.bytes += children * std::int64_t((n - first) * sizeof(NodeRecord));
  }
  out.leaves.messages = count_of(plan.leaf_ranks.to);
  for (Gift const& gift : plan.leaves)
    if (full.has_charge(gift.block)) out.leaves.bytes += std::int64_t(sizeof(LeafRecord));
  out.received_messages += count_of(family_ranks.from) + count_of(plan.leaf_ranks.from);
  for (Transfer const& step : plan.down) {
    out.down = out.down + sent(step.asked);
    out.received_messages += sent(step.wanted).messages;
  }
  out.walls = sent(plan.blocks.asked);
  out.received_messages += sent(plan.blocks.wanted).messages;

  // What this rank sees, and what it makes of it.
  std::set<Block> opened, summed;
  plan.for_each_seen([&](Block const& block) {
    (grids[block.grid].is_leaf() ? summed : opened).insert(block);
    return false;
  });
  std::vector<NodeRecord> nodes;
  for (Block const& block : opened) {
    if (!full.has_charge(block)) continue;
    auto const children = full.children(block);
    bool const is_received = block.grid <= geometry.top && geometry.home(block) != plan.rank();
    out.nodes_received += is_received ? count_of(children) : 0;
    nodes.insert(nodes.end(), children.begin(), children.end());
  }
  for (Block const& leaf : summed) out.leaves_received += full.has_charge(leaf) && geometry.home(leaf) != plan.rank();
  Block const all{grids.count() - 1, {0, 0, 0}};
  if (!full.has_charge(all)) return out;
  OctreeBuilder builder(grids, 0);
  builder.add_found(all.grid, {full.record(all)});
  Images const& images = geometry.mesh.images;
  TreePotential const potential(geometry.mesh.lattice, int(geometry.mesh.levels.size()) - 1, !images.are_none(),
                                options);
  Octree tree = builder.finish(nodes, geometry.top);
  add_images(tree, images, Which::all, options);
  potential.for_each_patch(tree, plan.patches, plan.is_own, [&](auto, std::vector<Interactions> const& interactions) {
    for (auto const& [image, far, mixed] : interactions) {
      out.far += count_of(far);
      out.near += count_of(mixed);
    }
  });
  return out;
}

}  // namespace amrpic::freespace
