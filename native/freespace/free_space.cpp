#include "freespace/free_space.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>
#include <set>

#include "base/error.hpp"
#include "freespace/heat_sums.hpp"

namespace amrpic::freespace {

namespace {

/// Call f(found, gift) for blocks found on this rank that are among some gifts; both are ascending.
template <class F>
void for_each_gift(OctreeBuilder const& builder, std::vector<Gift> const& gifts, F&& f) {
  auto found = std::vector<OctreeBuilder::Found>::const_iterator();
  int grid = -1;
  for (Gift const& gift : gifts) {
    auto const& of_grid = builder.found(gift.block.grid);
    if (gift.block.grid != grid) found = of_grid.begin(), grid = gift.block.grid;
    while (found != of_grid.end() && by_place(found->place, gift.block.place)) ++found;
    if (found != of_grid.end() && found->place == gift.block.place) f(*found, gift);
  }
}

/// A list for each rank that expects one.
template <class T>
std::map<int, std::vector<T>> lists_for(std::vector<int> const& ranks) {
  std::map<int, std::vector<T>> out;
  for (int rank : ranks) out[rank];
  return out;
}

/// The cells of a level that no open face sees, should there be any.
std::optional<ChargeBox::CellRange> unseen_cells(WallMesh const& mesh, int level, int operator_order) {
  ChargeBox::CellRange out;
  for (int d = 0; d < 3; ++d) {
    int lower = 0, upper = mesh.lattice.cells[d];
    for (int side = 0; side < 2; ++side) {
      if (!mesh.open[std::size_t(2 * d + side)]) continue;
      auto const seen = mesh.images.cells_seen(d, operator_order);
      if (!seen) return {};
      side == 0 ? lower += * seen : upper -= *seen;
    }
    if (lower >= upper) return {};
    out.lower[d] = lower << level;
    out.upper[d] = (upper << level) - 1;
  }
  return out;
}

/// Of the magnitudes of all charge.
void check_finite(double total) {
  if (!std::isfinite(total))
    throw SolverError(
        "the charge is not finite, or so large that its potential is not; look for the step that made it");
}

}  // namespace

FreeSpace::FreeSpace(Communicator const& comm, Lattice const& lattice, bool has_images, Options const& options)
    : comm_(comm),
      lattice_(lattice),
      has_images_(has_images),
      options_(options),
      evaluate_(std::make_unique<TreePotential const>(lattice, 0, has_images, options)) {}

std::shared_ptr<WallPlan const> FreeSpace::plan(WallMesh const& mesh) const {
  return std::make_shared<WallPlan const>(std::make_shared<WallGeometry const>(mesh, options_), comm_.rank());
}

std::vector<double> FreeSpace::walls(WallPlan const& plan, std::vector<ChargeBox> const& local, Which which) {
  if (plan.geometry().by_axes) {
    auto values = sums_by_axes(plan, options_, all_charges(plan, local), which);
    for (double& value : values) value /= lattice_.unit();
    return values;
  }
  ChargeBlocks const blocks = own_charges(plan, local);
  OctreeBuilder builder = leaves_of(plan, blocks);
  join_upwards(plan, builder);
  auto const near = leaves_of_others(plan, builder, blocks);
  Octree tree = builder.finish(children_of_others(plan, builder), plan.geometry().top);
  Images const& images = plan.geometry().mesh.images;
  add_images(tree, images, which, options_);
  std::vector<double> values;
  try {
    Closing const closing(tree, images, which, options_);
    values = evaluate_->at({tree, blocks, near}, closing, plan.patches, plan.is_own);
  } catch (std::exception const& e) {
    if (comm_.ranks() == 1) throw;
    comm_.abort(e.what());
  }
  interpolate_down(plan, values);
  return at_own_walls(plan, values);
}

/// Of all cells of all levels, in the order of their boxes.
std::vector<double> FreeSpace::all_charges(WallPlan const& plan, std::vector<ChargeBox> const& local) const {
  auto const& levels = plan.geometry().mesh.levels;
  std::vector<GlobalIndex> first{0};
  for (auto const& level : levels) first.push_back(first.back() + level->cells());
  std::vector<double> out(std::size_t(first.back()), 0.0);
  auto box = local.begin();
  for (std::size_t l = 0; l < levels.size(); ++l)
    for (int b = levels[l]->first_box(plan.rank()); b < levels[l]->first_box(plan.rank() + 1); ++b)
      copy_charges(*box++, out.data() + first[l] + levels[l]->box_offset(b));
  comm_.sum_each(out);
  double total = 0;
  for (double charge : out) total += std::abs(charge);
  check_finite(total);
  return out;
}

/// The blocks of this rank, with what other ranks hold of them.
ChargeBlocks FreeSpace::own_charges(WallPlan const& plan, std::vector<ChargeBox> local) const {
  for (ChargeBox& box : local) box.unseen = unseen_cells(plan.geometry().mesh, box.level, options_.operator_order);
  std::vector<double> received;
  std::vector<Parcel> asked, wanted;
  std::vector<std::size_t> first;
  for (LeafPart const& part : plan.parts_out) asked.push_back({part.rank, part.cells.cells()});
  for (LeafPart const& part : plan.parts_in) {
    wanted.push_back({part.rank, part.cells.cells()});
    first.push_back(received.size());
    received.resize(received.size() + std::size_t(part.cells.cells()));
  }
  Exchange<double> const exchange(comm_, asked, wanted);
  exchange.update(
      [&](std::size_t n, double* to) {
        LeafPart const& part = plan.parts_out[n];
        copy_charges(local[std::size_t(part.box)], part.cells.lower, part.cells.upper, to);
      },
      [&](std::size_t n, double const* from) {
        std::copy_n(from, plan.parts_in[n].cells.cells(), received.data() + first[n]);
      });
  for (std::size_t n = 0; n < first.size(); ++n) {
    LeafPart const& part = plan.parts_in[n];
    local.push_back({part.key.level, part.cells.lower, part.cells.upper, received.data() + first[n], 1.0});
  }
  ChargeBlocks out(lattice_, near_cells(lattice_, options_));
  out.assign(local, plan.foreign);
  return out;
}

/// The leaves that count. The weakest do not while they sum to less than `dropped` of all |q|: by whole octaves of
/// magnitude, since a choice between leaves that differ only by rounding would depend on the number of ranks.
OctreeBuilder FreeSpace::leaves_of(WallPlan const& plan, ChargeBlocks const& blocks) {
  std::vector<double> sums(octaves + most_levels, 0.0);
  for (auto const& [leaf, moments] : blocks.leaves()) {
    int const octave = std::isfinite(leaf.magnitude) ? std::ilogb(leaf.magnitude) - lowest_octave : octaves - 1;
    sums[std::size_t(octave)] += leaf.magnitude;
    sums[std::size_t(octaves + leaf.key.level)] += 1;
  }
  comm_.sum_each(sums);
  double total = 0;
  for (int n = 0; n < octaves; ++n) total += sums[std::size_t(n)];
  check_finite(total);
  int weakest = 0;
  for (double sum = 0; weakest < octaves && (sum += sums[std::size_t(weakest)]) < options_.dropped * total;) ++weakest;
  int finest = 0;
  for (int level = 0; level < most_levels; ++level)
    if (sums[std::size_t(octaves + level)] > 0) finest = level;
  if (evaluate_->finest() < finest)
    evaluate_ = std::make_unique<TreePotential const>(lattice_, finest, has_images_, options_);

  std::vector<int> order;
  for (std::size_t n = 0; n < blocks.leaves().size(); ++n)
    if (weakest == octaves || std::ilogb(blocks.leaves()[n].leaf.magnitude) >= lowest_octave + weakest)
      order.push_back(int(n));
  std::sort(order.begin(), order.end(), [&](int a, int b) {
    return blocks.leaves()[std::size_t(a)].leaf.key < blocks.leaves()[std::size_t(b)].leaf.key;
  });
  BlockGrids const& grids = plan.geometry().grids;
  OctreeBuilder out(grids, blocks.leaves().size());
  Point const shape = lattice_.shape();
  for (int n : order) {
    LeafMoments const& part = blocks.leaves()[std::size_t(n)];
    out.add_leaf(grids.leaves(part.leaf.key.level), part.leaf.key.place, leaf_member(part, n, shape));
  }
  return out;
}

/// Join blocks grid by grid at the ranks they belong to, then what is known everywhere.
void FreeSpace::join_upwards(WallPlan const& plan, OctreeBuilder& builder) const {
  WallGeometry const& geometry = plan.geometry();
  for (int grid = 0; grid < geometry.grids.count(); ++grid) {
    BlockGrid const& of = geometry.grids[grid];
    if (of.is_leaf() && grid != geometry.top) continue;
    auto to = lists_for<NodeRecord>(plan.joins[std::size_t(grid)].to);
    std::vector<NodeRecord> received;
    auto const is_away = [&](Block const& child) {
      auto const& away = plan.upwards[std::size_t(child.grid)];
      auto const place = std::lower_bound(away.begin(), away.end(), Gift{child, -1});
      return place != away.end() && place->block == child;
    };
    if (!of.is_leaf()) {
      for (int child : {of.finer, of.own})
        if (child >= 0)
          for_each_gift(builder, plan.upwards[std::size_t(child)], [&](auto const& found, Gift const& gift) {
            to[gift.rank].push_back({gift.block, packed(builder.member(found))});
          });
      received = comm_.swapped(to, plan.joins[std::size_t(grid)].from);
      builder.join(grid, received, [&](Block const& child) { return !is_away(child); });
    }
    if (grid == geometry.top && comm_.ranks() > 1) builder.add_found(grid, known_on_all(geometry, builder));
  }
}

/// The nodes of all blocks of the top.
std::vector<NodeRecord> FreeSpace::known_on_all(WallGeometry const& geometry, OctreeBuilder const& builder) const {
  std::vector<NodeRecord> own;
  for (auto const& found : builder.found(geometry.top))
    own.push_back({{geometry.top, found.place}, packed(builder.member(found))});
  return united(geometry.top_blocks(), own);
}

/// The nodes of those of some blocks that any rank has one of, in their order; each rank has its own ones.
std::vector<NodeRecord> FreeSpace::united(std::vector<Block> const& blocks, std::vector<NodeRecord> const& own) const {
  constexpr std::size_t words = sizeof(NodeRecord::Content) / sizeof(std::int64_t);
  std::map<Block, std::size_t> number;
  for (std::size_t n = 0; n < blocks.size(); ++n) number[blocks[n]] = n;
  std::vector<std::int64_t> all(blocks.size() * words, 0);
  for (NodeRecord const& record : own)
    std::memcpy(all.data() + words * number.at(record.block), &record.content, sizeof record.content);
  comm_.unite_each(all);
  std::vector<NodeRecord> out;
  for (std::size_t n = 0; n < blocks.size(); ++n) {
    NodeRecord record{blocks[n], {}};
    std::memcpy(&record.content, all.data() + words * n, sizeof record.content);
    if (record.content.magnitude > 0) out.push_back(record);
  }
  return out;
}

/// The children of blocks of other ranks that patches of this one may look into: those right below the top from all to
/// all while they are few, others from rank to rank.
std::vector<NodeRecord> FreeSpace::children_of_others(WallPlan const& plan, OctreeBuilder const& builder) const {
  WallGeometry const& geometry = plan.geometry();
  std::vector<NodeRecord> out;
  std::vector<Block> known;
  for (auto const& found : builder.found(geometry.top)) known.push_back({geometry.top, found.place});
  int below = 0;
  for (auto children = geometry.shared_children(known); !children.empty(); children = geometry.shared_children(known)) {
    std::set<int> grids;
    for (Block const& block : known) grids.insert(block.grid);
    std::vector<NodeRecord> own;
    for (int grid : grids)
      for (auto const& found : builder.found(grid)) builder.append_children(grid, found, own);
    known.clear();
    for (NodeRecord const& record : united(children, own)) {
      known.push_back(record.block);
      if (geometry.home(geometry.grids.parent(record.block)) != plan.rank()) out.push_back(record);
    }
    ++below;
  }
  Senders const ranks = plan.family_ranks_below(known, below);
  auto to = lists_for<NodeRecord>(ranks.to);
  for_each_gift(builder, plan.families, [&](auto const& found, Gift const& gift) {
    if (geometry.below_top(gift.block.grid) >= below) builder.append_children(gift.block.grid, found, to[gift.rank]);
  });
  auto const received = comm_.swapped(to, ranks.from);
  out.insert(out.end(), received.begin(), received.end());
  return out;
}

/// The charges of leaves of other ranks that patches of this one may have to sum one by one.
std::vector<LeafRecord> FreeSpace::leaves_of_others(WallPlan const& plan, OctreeBuilder const& builder,
                                                    ChargeBlocks const& blocks) const {
  auto to = lists_for<LeafRecord>(plan.leaf_ranks.to);
  for_each_gift(builder, plan.leaves, [&](auto const& found, Gift const& gift) {
    auto const leaf = std::size_t(builder.member(found).node.leaf);
    if (blocks.has_charges(leaf)) to[gift.rank].push_back({blocks.leaves()[leaf].leaf.key, blocks.charges(leaf)});
  });
  return comm_.swapped(to, plan.leaf_ranks.from);
}

/// Add to the values of each patch what those of its parent are there, from the widest ones down.
void FreeSpace::interpolate_down(WallPlan const& plan, std::vector<double>& values) const {
  PatchInterpolation interpolation;
  auto const at = [&values](int patch) { return values.data() + std::size_t(patch) * patch_values; };
  auto const add = [&](int patch, double const* of_parent) {
    GhostPatch const& child = plan.patches[std::size_t(patch)];
    interpolation.add(plan.patches[std::size_t(child.parent)], of_parent, child, at(patch));
  };
  for (std::size_t generation = 1; generation < plan.down.size(); ++generation) {
    Transfer const& step = plan.down[generation];
    Exchange<double> const exchange(comm_, step.asked, step.wanted);
    exchange.start([&](std::size_t n, double* to) { std::copy_n(at(step.give[n]), patch_values, to); });
    for (int patch : plan.generations[generation])
      if (plan.is_own[std::size_t(patch)] && plan.is_own[std::size_t(plan.patches[std::size_t(patch)].parent)])
        add(patch, at(plan.patches[std::size_t(patch)].parent));
    exchange.finish([&](std::size_t n, double const* from) { add(step.take[n], from); });
    exchange.settle();
  }
}

/// The values of blocks of ghosts, from whoever evaluated them to the owners of the cells before them; in V.
std::vector<double> FreeSpace::at_own_walls(WallPlan const& plan, std::vector<double> const& values) const {
  double const scale = 1 / (12.566370614359172954 * lattice_.unit());  // 4 pi, and lengths in units of the smallest
  std::vector<double> out(plan.wall_blocks.size() * patch_values);
  auto const put = [&](double const* from, int block) {
    double* const to = out.data() + std::size_t(block) * patch_values;
    for (int n = 0; n < patch_values; ++n) to[n] = scale * from[n];
  };
  for (auto const& [patch, block] : plan.kept_blocks) put(values.data() + std::size_t(patch) * patch_values, block);
  Exchange<double> const exchange(comm_, plan.blocks.asked, plan.blocks.wanted);
  exchange.update(
      [&](std::size_t n, double* to) {
        std::copy_n(values.data() + std::size_t(plan.blocks.give[n]) * patch_values, patch_values, to);
      },
      [&](std::size_t n, double const* from) { put(from, plan.blocks.take[n]); });
  return out;
}

}  // namespace amrpic::freespace
