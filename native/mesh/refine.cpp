#include "mesh/refine.hpp"

#include <algorithm>
#include <string>

#include "base/error.hpp"
#include "mesh/array_on_box.hpp"
#include "mesh/cluster.hpp"

namespace amrpic {

namespace {

using Key = std::int64_t;  ///< coordinates of a block in one number

constexpr int key_bits = 21;

Key to_key(Index3 const& block) {
  return Key(block[0]) | (Key(block[1]) << key_bits) | (Key(block[2]) << (2 * key_bits));
}
Index3 from_key(Key key) {
  constexpr Key mask = (Key(1) << key_bits) - 1;
  return {int(key & mask), int((key >> key_bits) & mask), int(key >> (2 * key_bits))};
}

void sort_unique(std::vector<Key>& keys) {
  std::sort(keys.begin(), keys.end());
  keys.erase(std::unique(keys.begin(), keys.end()), keys.end());
}

/// The blocks of a level: what can be refined or not. The last one along an axis may be shorter.
///
/// Blocks are counted on outside the domain. Behind an upper periodic face begins an image of the domain with as many
/// blocks, the first of them block 0 again, so that a short last block has its neighbours where its cells have theirs.
class BlockGrid {
 public:
  BlockGrid(Hierarchy const& hierarchy, int level) : edge_(hierarchy.blocking_factor()) {
    Domain const& domain = hierarchy.domain();
    for (int d = 0; d < 3; ++d) {
      cells_[d] = std::int64_t(domain.cells[d]) << std::min(level, key_bits);
      std::int64_t const blocks = (cells_[d] + edge_ - 1) / edge_;
      if (level > key_bits || blocks > (1 << (key_bits - 1)))
        throw HierarchyError("level " + std::to_string(level) + " would have more than 2^20 blocks along " + "xyz"[d] +
                             "; use fewer levels");
      extent_[d] = int(blocks);
      periodic_[d] = domain.periodic(d);
    }
  }

  /// The block along an axis that holds a cell of the level, which may lie outside the domain.
  int block(int axis, std::int64_t cell) const {
    auto const divide = [](std::int64_t a, std::int64_t b) { return a / b - (a % b < 0); };
    std::int64_t const image = periodic_[axis] ? divide(cell, cells_[axis]) : 0;
    return int(image * extent_[axis] + divide(cell - image * cells_[axis], edge_));
  }

  /// The blocks that a region of cells touches.
  Box blocks(Box const& cells) const {
    Box out;
    for (int d = 0; d < 3; ++d) out.lower[d] = block(d, cells.lower[d]), out.upper[d] = block(d, cells.upper[d]);
    return out;
  }

  /// The cells of a region of blocks in the domain.
  Box cells(Box const& blocks) const {
    Box out;
    for (int d = 0; d < 3; ++d) {
      out.lower[d] = blocks.lower[d] * edge_;
      out.upper[d] = int(std::min((std::int64_t(blocks.upper[d]) + 1) * edge_, cells_[d]) - 1);
    }
    return out;
  }

  /// Append a region of blocks, wrapped where periodic and clipped elsewhere.
  void append(Box region, std::vector<Key>& out) const {
    for (int d = 0; d < 3; ++d)
      if (periodic_[d])
        region.upper[d] = std::min(region.upper[d], region.lower[d] + extent_[d] - 1);  // once around is everything
      else
        region.lower[d] = std::max(region.lower[d], 0), region.upper[d] = std::min(region.upper[d], extent_[d] - 1);
    for_each_cell(region, [&](Index3 const& block) { out.push_back(to_key(wrap(block))); });
  }

 private:
  Index3 wrap(Index3 block) const {
    for (int d = 0; d < 3; ++d)
      if (periodic_[d]) block[d] -= floor_divide(block[d], extent_[d]) * extent_[d];
    return block;
  }

  int edge_;
  std::array<std::int64_t, 3> cells_;
  Index3 extent_;  ///< blocks
  std::array<bool, 3> periodic_;
};

/// Marks per cell turned, along one axis, into marks per block of the next finer level, each first grown by `buffer`
/// cells both ways.
ArrayOnBox<char> grow_and_coarsen(ArrayOnBox<char> const& cells, int axis, int buffer, BlockGrid const& finer) {
  auto first = [&](int cell) { return finer.block(axis, 2 * (std::int64_t(cell) - buffer)); };
  auto last = [&](int cell) { return finer.block(axis, 2 * (std::int64_t(cell) + buffer)); };
  Box box = cells.box();
  box.lower[axis] = first(box.lower[axis]);
  box.upper[axis] = last(box.upper[axis]);
  ArrayOnBox<char> out(box, 0);
  for_each_cell(cells.box(), [&](Index3 const& cell) {
    if (!cells(cell)) return;
    Index3 block = cell;
    for (block[axis] = first(cell[axis]); block[axis] <= last(cell[axis]); ++block[axis]) out(block) = 1;
  });
  return out;
}

/// Blocks of the next finer level that this rank's tags of one kind reach.
std::vector<Key> tagged_blocks(Level const& level, std::uint8_t const* tags, std::uint8_t kind,
                               BlockGrid const& lattice, int buffer) {
  std::vector<Key> out;
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
    ArrayOnBox<char> marks(level.box(b), 0);
    std::uint8_t const* first = tags + level.local_offset(b);
    auto const last = first + level.box(b).cells();
    if (std::none_of(first, last, [&](std::uint8_t tag) { return tag & kind; })) continue;
    std::transform(first, last, marks.values().begin(), [&](std::uint8_t tag) { return (tag & kind) != 0; });
    // A cube around a tag is the product of intervals, so the axes can be grown one after the other.
    for (int axis = 0; axis < 3; ++axis) marks = grow_and_coarsen(marks, axis, buffer, lattice);
    for_each_cell(marks.box(), [&](Index3 const& block) {
      if (marks(block)) lattice.append({block, block}, out);
    });
  }
  sort_unique(out);
  return out;
}

/// The blocks that a level has, of the given ones.
std::vector<Key> existing(std::vector<Key> keys, Level const& level, int edge) {
  auto missing = [&](Key key) {
    Index3 const block = from_key(key);
    return level.find({block[0] * edge, block[1] * edge, block[2] * edge}) < 0;
  };
  keys.erase(std::remove_if(keys.begin(), keys.end(), missing), keys.end());
  return keys;
}

std::vector<Box> boxes_of_blocks(std::vector<Key> const& keys, Real efficiency, BlockGrid const& lattice) {
  std::vector<Index3> blocks(keys.size());
  std::transform(keys.begin(), keys.end(), blocks.begin(), from_key);
  std::vector<Box> boxes = cluster(std::move(blocks), efficiency);
  for (Box& box : boxes) box = lattice.cells(box);
  return boxes;
}

}  // namespace

std::vector<std::vector<Box>> refine(Hierarchy const& hierarchy, std::vector<std::uint8_t const*> const& tags,
                                     std::vector<std::vector<Box>> const& fixed, RefineOptions const& options) {
  int const edge = hierarchy.blocking_factor();
  int const tagged = std::min(int(tags.size()), hierarchy.level_count());
  int const finest = std::min(options.max_levels - 1, std::max(tagged, int(fixed.size())));
  std::vector<std::vector<Box>> levels(std::size_t(std::max(finest, 0)));

  // From the finest down: the cells that a level itself needs are known; the nesting of the finer one is added.
  for (int l = finest; l > 0; --l) {
    BlockGrid const lattice(hierarchy, l);
    std::vector<Key> blocks;
    if (l - 1 < tagged) {
      std::vector<Key> mine;
      auto reached = [&](std::uint8_t kind) {
        return tagged_blocks(hierarchy.level(l - 1), tags[l - 1], kind, lattice, options.buffer);
      };
      if (tags[l - 1]) {
        mine = reached(wanted);
        if (l < hierarchy.level_count())
          for (Key key : existing(reached(kept), hierarchy.level(l), edge)) mine.push_back(key);
        sort_unique(mine);
      }
      blocks = hierarchy.comm().gather(mine).values;
    }
    if (l <= int(fixed.size()))
      for (Box const& box : fixed[l - 1]) lattice.append(lattice.blocks(box), blocks);
    if (l < finest)
      for (Box const& box : levels[l])
        lattice.append(lattice.blocks(box.coarsen(refinement_ratio).grow(options.nesting)), blocks);
    sort_unique(blocks);
    levels[l - 1] = boxes_of_blocks(blocks, options.efficiency, lattice);
  }
  while (!levels.empty() && levels.back().empty()) levels.pop_back();
  return levels;
}

}  // namespace amrpic
