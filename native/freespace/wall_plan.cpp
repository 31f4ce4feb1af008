#include "freespace/wall_plan.hpp"

#include <algorithm>
#include <map>
#include <set>
#include <tuple>

#include "freespace/octree.hpp"
#include "freespace/tree_potential.hpp"

namespace amrpic::freespace {

namespace {

constexpr double most_images = 64;                        ///< near, that the tree serves, whatever the mesh
constexpr double cells_per_image = 8;                     ///< that are summed while the tree takes one, on some ranks
constexpr GlobalIndex most_cells = GlobalIndex(1) << 20;  ///< whose charge every rank may hold
constexpr int most_known_blocks = (64 << 10) / sizeof(NodeRecord::Content);  ///< of the top: one message of 64 KB

Senders senders(std::set<int> const& to, std::set<int> const& from) {
  return {{to.begin(), to.end()}, {from.begin(), from.end()}};
}

bool are_summed_by_axes(WallMesh const& mesh, std::size_t blocks, Options const& options) {
  Point const shape = mesh.lattice.shape();
  Cell const near = near_cells(mesh.lattice, options);
  double distance = 0;
  for (int d = 0; d < 3; ++d) distance = std::max(distance, near[d] * shape[d]);
  double const images = mesh.images.copies_within(distance);
  GlobalIndex cells = 0;
  for (auto const& level : mesh.levels) cells += level->cells();
  return images > most_images && cells <= most_cells && double(cells) < cells_per_image * images * double(blocks);
}

bool in_order(LeafPart const& a, LeafPart const& b) {
  auto const rest = [](LeafPart const& p) { return std::tie(p.cells.lower[2], p.cells.lower[1], p.cells.lower[0]); };
  if (a.rank != b.rank) return a.rank < b.rank;
  return a.key == b.key ? rest(a) < rest(b) : a.key < b.key;
}

}  // namespace

WallGeometry::WallGeometry(WallMesh const& given, Options const& options)
    : mesh(given),
      grids(mesh.lattice, int(mesh.levels.size()) - 1),
      patches(mesh),
      sight(mesh, grids, patches, options),
      top(grids.with_at_most(most_known_blocks)),
      fewest_sharing_ranks(options.fewest_sharing_ranks),
      by_axes(are_summed_by_axes(mesh, patches.blocks().size(), options)) {}

int WallGeometry::home(Block const& block) const {
  Level const& level = mesh.level(grids[block.grid].level);
  Box const cells = grids.cells(block);
  Index3 middle;
  for (int d = 0; d < 3; ++d) middle[d] = (cells.lower[d] + cells.upper[d] + 1) / 2;
  int box = level.find(middle);
  if (box < 0) level.for_each_overlap(cells, [&](int b, Box const&, Index3 const&) { box = box < 0 ? b : box; });
  return box < 0 ? -1 : level.owner(box);
}

std::vector<Block> WallGeometry::top_blocks() const {
  Cell const extent = grids.extent(top);
  std::vector<Block> out;
  Cell place;
  for (place[2] = 0; place[2] < extent[2]; ++place[2])
    for (place[1] = 0; place[1] < extent[1]; ++place[1])
      for (place[0] = 0; place[0] < extent[0]; ++place[0]) out.push_back({top, place});
  return out;
}

bool WallGeometry::is_shared() const { return mesh.ranks() > 1 && mesh.ranks() >= fewest_sharing_ranks; }

int WallGeometry::below_top(int grid) const {
  int out = 0;
  for (; grid != top; grid = grids[grid].parent) ++out;
  return out;
}

std::vector<Block> WallGeometry::shared_children(std::vector<Block> const& blocks) const {
  std::vector<Block> out;
  if (!is_shared()) return out;
  for (Block const& block : blocks) grids.for_each_child(block, [&](Block const& child) { out.push_back(child); });
  if (int(out.size()) > most_known_blocks) out.clear();
  return out;
}

WallPlan::WallPlan(std::shared_ptr<WallGeometry const> geometry, int rank)
    : geometry_(std::move(geometry)), rank_(rank) {
  find_wall_blocks();
  if (geometry_->by_axes) return;
  plan_parts();
  if (geometry_->mesh.ranks() > 1)
    for (int grid = 0; grid <= geometry_->top; ++grid) own_blocks_.push_back(own_blocks(grid));
  plan_joins();
  plan_patches();
  plan_gifts();
  plan_walls();
}

/// Call f(level, box) for the boxes of this rank, level by level.
template <class F>
void WallPlan::for_each_own_box(F&& f) const {
  for (int l = 0; l < int(geometry_->mesh.levels.size()); ++l) {
    Level const& level = geometry_->mesh.level(l);
    for (int b = level.first_box(rank_); b < level.first_box(rank_ + 1); ++b) f(l, level.box(b));
  }
}

/// Call f(place) for the blocks of `width` that a box has cells of.
template <class F>
static void for_each_place(Box const& box, Cell const& width, F&& f) {
  Cell place;
  for (place[2] = box.lower[2] / width[2]; place[2] <= box.upper[2] / width[2]; ++place[2])
    for (place[1] = box.lower[1] / width[1]; place[1] <= box.upper[1] / width[1]; ++place[1])
      for (place[0] = box.lower[0] / width[0]; place[0] <= box.upper[0] / width[0]; ++place[0]) f(place);
}

std::vector<Block> WallPlan::own_blocks(int grid) const {
  std::vector<Block> out;
  auto const& [level, width] = std::tie(geometry_->grids[grid].level, geometry_->grids[grid].width);
  for_each_own_box([&](int l, Box const& box) {
    if (l != level) return;
    for_each_place(box, width, [&](Cell const& place) {
      if (geometry_->home({grid, place}) == rank_) out.push_back({grid, place});
    });
  });
  std::sort(out.begin(), out.end());
  out.erase(std::unique(out.begin(), out.end()), out.end());
  return out;
}

void WallPlan::plan_parts() {
  if (geometry_->mesh.ranks() == 1) return;
  int number = 0;
  Cell const width{block_edge, block_edge, block_edge};
  for_each_own_box([&](int l, Box const& box) {
    Level const& level = geometry_->mesh.level(l);
    int const grid = geometry_->grids.leaves(l);
    for_each_place(box, width, [&](Cell const& place) {
      Box const cells = geometry_->grids.cells({grid, place});
      if (box.contains(cells)) return;
      BlockKey const key{l, place};
      int const home = geometry_->home({grid, place});
      if (home != rank_) {
        parts_out.push_back({home, key, box.intersect(cells), number});
        foreign.push_back(key);
        return;
      }
      level.for_each_overlap(cells, [&](int b, Box const& part, Index3 const&) {
        if (level.owner(b) != rank_) parts_in.push_back({level.owner(b), key, part, -1});
      });
    });
    ++number;
  });
  std::sort(foreign.begin(), foreign.end());
  foreign.erase(std::unique(foreign.begin(), foreign.end()), foreign.end());
  std::sort(parts_out.begin(), parts_out.end(), in_order);
  std::sort(parts_in.begin(), parts_in.end(), in_order);
  auto const same = [](LeafPart const& a, LeafPart const& b) { return !in_order(a, b) && !in_order(b, a); };
  parts_in.erase(std::unique(parts_in.begin(), parts_in.end(), same), parts_in.end());  // several own boxes in a leaf
}

void WallPlan::plan_joins() {
  BlockGrids const& grids = geometry_->grids;
  upwards.resize(std::size_t(grids.count()));
  joins.resize(std::size_t(grids.count()));
  if (geometry_->mesh.ranks() == 1) return;
  for (int grid = 0; grid <= geometry_->top; ++grid) {
    std::set<int> to, from;
    for (int child : {grids[grid].finer, grids[grid].own}) {
      if (child < 0) continue;
      for (Block const& block : own_blocks_[std::size_t(child)]) {
        int const home = geometry_->home(grids.parent(block));
        if (home == rank_) continue;
        upwards[std::size_t(child)].push_back({block, home});
        to.insert(home);
      }
    }
    for (Block const& block : own_blocks_[std::size_t(grid)])
      grids.for_each_child(block, [&](Block const& child) {
        int const home = geometry_->home(child);
        if (home >= 0 && home != rank_) from.insert(home);
      });
    joins[std::size_t(grid)] = senders(to, from);
  }
}

void WallPlan::plan_patches() {
  WallPatches const& all = geometry_->patches;
  std::map<int, int> local;  // by number: whether it is this rank's
  for (int p = 0; p < all.count(); ++p)
    if (all.owner(p) == rank_) {
      local[p] = 1;
      for (int above = all[p].parent; above >= 0; above = all[above].parent) local.emplace(above, 0);
    }
  std::map<int, int> place;
  for (auto const& [p, own] : local) {
    place[p] = int(numbers_.size());
    numbers_.push_back(p);
    is_own.push_back(char(own || all.owner(p) == rank_));
    patches.push_back(all[p]);
  }
  int last = 0;
  std::vector<int> depth(patches.size(), 0);
  for (std::size_t n = patches.size(); n-- > 0;) {
    int& parent = patches[n].parent;
    if (parent < 0) continue;
    parent = place[parent];
    depth[n] = depth[std::size_t(parent)] + 1;
    last = std::max(last, depth[n]);
  }

  // A parent's values go to each child of another rank.
  struct Step {
    int generation, rank, child, patch;
    bool operator<(Step const& o) const {
      return std::tie(generation, rank, child) < std::tie(o.generation, o.rank, o.child);
    }
  };
  std::vector<Step> out, in;
  for (std::size_t n = 0; n < patches.size(); ++n) {
    if (!is_own[n]) continue;
    int const p = numbers_[n], above = all[p].parent;
    for (int c = all.first_child(p); c < all.first_child(p + 1); ++c) {
      int const child = all.children()[std::size_t(c)];
      if (all.owner(child) != rank_) out.push_back({depth[n] + 1, all.owner(child), child, int(n)});
      last = std::max(last, depth[n] + 1);
    }
    if (above >= 0 && all.owner(above) != rank_) in.push_back({depth[n], all.owner(above), p, int(n)});
  }
  std::sort(out.begin(), out.end());
  std::sort(in.begin(), in.end());
  down.resize(std::size_t(last) + 1);
  generations.resize(down.size());
  for (std::size_t n = 0; n < patches.size(); ++n) generations[std::size_t(depth[n])].push_back(int(n));
  for (Step const& s : out) {
    down[std::size_t(s.generation)].asked.push_back({s.rank, patch_values});
    down[std::size_t(s.generation)].give.push_back(s.patch);
  }
  for (Step const& s : in) {
    down[std::size_t(s.generation)].wanted.push_back({s.rank, patch_values});
    down[std::size_t(s.generation)].take.push_back(s.patch);
  }
  plan_sources();
}

/// From the widest blocks down.
void WallPlan::for_each_seen(std::function<bool(Block const&)> const& f) const {
  BlockGrids const& grids = geometry_->grids;
  std::vector<Block> stack;
  for (std::size_t n = 0; n < patches.size(); ++n) {
    if (!is_own[n]) continue;
    for (stack.assign(1, {grids.count() - 1, {0, 0, 0}}); !stack.empty();) {
      Block const block = stack.back();
      stack.pop_back();
      Sight const& sight = geometry_->sight;
      bool const is_seen =
          grids[block.grid].is_leaf() ? sight.sums(numbers_[n], block) : sight.opens(numbers_[n], block);
      if (!is_seen || geometry_->home(block) < 0) continue;
      if (f(block)) return;
      grids.for_each_child(block, [&](Block const& child) { stack.push_back(child); });
    }
  }
}

/// Of whom this rank's patches may need nodes and charges.
void WallPlan::plan_sources() {
  auto const others = std::size_t(geometry_->mesh.ranks() - 1);
  if (others == 0) return;
  std::set<int> nodes, charges;
  std::set<Gift> parents;
  for_each_seen([&](Block const& block) {
    bool const is_leaf = geometry_->grids[block.grid].is_leaf();
    int const home = is_leaf || block.grid <= geometry_->top ? geometry_->home(block) : rank_;
    if (home == rank_) return false;
    (is_leaf ? charges : nodes).insert(home);
    if (!is_leaf && geometry_->is_shared()) parents.insert({block, home});
    return !geometry_->is_shared() && nodes.size() == others && charges.size() == others;
  });
  seen.assign(parents.begin(), parents.end());
  family_ranks.from.assign(nodes.begin(), nodes.end());
  leaf_ranks.from.assign(charges.begin(), charges.end());
}

/// Whose patches may need the children of this rank's blocks, and the charges of its leaves.
void WallPlan::plan_gifts() {
  auto const others = std::size_t(geometry_->mesh.ranks() - 1);
  if (others == 0) return;
  std::set<int> family_to, leaf_to;
  for (int grid = 0; grid <= geometry_->top; ++grid) {
    bool const are_leaves = geometry_->grids[grid].is_leaf();
    for (Block const& block : own_blocks_[std::size_t(grid)]) {
      std::set<int> ranks;
      auto const add = [&](int patch) {
        if (geometry_->patches.owner(patch) != rank_) ranks.insert(geometry_->patches.owner(patch));
        return ranks.size() == others;
      };
      if (are_leaves)
        geometry_->sight.for_each_that_sums(block, add);
      else
        geometry_->sight.for_each_that_opens(block, add);
      for (int rank : ranks) (are_leaves ? leaves : families).push_back({block, rank});
      (are_leaves ? leaf_to : family_to).insert(ranks.begin(), ranks.end());
    }
  }
  family_ranks.to.assign(family_to.begin(), family_to.end());
  leaf_ranks.to.assign(leaf_to.begin(), leaf_to.end());
}

Senders WallPlan::family_ranks_below(std::vector<Block> known, int below) const {
  if (!geometry_->is_shared()) return family_ranks;
  std::sort(known.begin(), known.end());
  auto const may_have_charge = [&](Block block) {
    int above = geometry_->below_top(block.grid) - below;
    if (above < 0) return false;  // known already
    for (; above > 0; --above) block = geometry_->grids.parent(block);
    return std::binary_search(known.begin(), known.end(), block);
  };
  std::set<int> to, from;
  for (Gift const& gift : families)
    if (may_have_charge(gift.block)) to.insert(gift.rank);
  for (Gift const& gift : seen)
    if (may_have_charge(gift.block)) from.insert(gift.rank);
  return senders(to, from);
}

void WallPlan::find_wall_blocks() {
  std::set<int> at_walls;
  for_each_own_box([&](int l, Box const& box) {
    for_each_ghost_block(geometry_->mesh, l, box,
                         [&](GhostBlock const& block) { at_walls.insert(geometry_->patches.number(block)); });
  });
  wall_blocks.assign(at_walls.begin(), at_walls.end());
}

void WallPlan::plan_walls() {
  WallPatches const& all = geometry_->patches;
  struct Item {
    int rank, block, patch;
    bool operator<(Item const& o) const { return std::tie(rank, block) < std::tie(o.rank, o.block); }
  };
  std::vector<Item> out, in;
  for (std::size_t n = 0; n < patches.size(); ++n) {
    if (!is_own[n] || !patches[n].is_block()) continue;
    GhostPatch const& patch = patches[n];
    GhostBlock const block{
        patch.face, patch.layer, patch.level, {patch.first[0] / patch_points, patch.first[1] / patch_points}};
    Level const& level = geometry_->mesh.level(block.level);
    std::set<int> readers;
    level.for_each_overlap(cells_before(geometry_->mesh, block),
                           [&](int b, Box const&, Index3 const&) { readers.insert(level.owner(b)); });
    for (int reader : readers)
      if (reader != rank_) out.push_back({reader, all.number(block), int(n)});
  }
  for (std::size_t n = 0; n < wall_blocks.size(); ++n) {
    int const owner = all.owner(wall_blocks[n]);
    if (owner == rank_)
      kept_blocks.push_back(
          {int(std::lower_bound(numbers_.begin(), numbers_.end(), wall_blocks[n]) - numbers_.begin()), int(n)});
    else
      in.push_back({owner, wall_blocks[n], int(n)});
  }
  std::sort(out.begin(), out.end());
  std::sort(in.begin(), in.end());
  for (Item const& item : out) {
    blocks.asked.push_back({item.rank, patch_values});
    blocks.give.push_back(item.patch);
  }
  for (Item const& item : in) {
    blocks.wanted.push_back({item.rank, patch_values});
    blocks.take.push_back(item.patch);
  }
}

std::size_t WallPlan::place(int face, int layer, int level, Index3 const& cell) const {
  auto const [u, v] = plane_axes(face / 2);
  int const number = geometry_->patches.number({face, layer, level, {cell[u] / patch_points, cell[v] / patch_points}});
  auto const block =
      std::size_t(std::lower_bound(wall_blocks.begin(), wall_blocks.end(), number) - wall_blocks.begin());
  return block * patch_values + std::size_t(cell[u] % patch_points + patch_points * (cell[v] % patch_points));
}

}  // namespace amrpic::freespace
