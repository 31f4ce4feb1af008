#include "freespace/block_grids.hpp"

#include <algorithm>

namespace amrpic::freespace {

namespace {

using Axes = std::array<bool, 3>;

/// Which axes to double next, so that blocks stay about as long as wide also where cells are not cubes.
Axes axes_to_double(Point const& width) {
  double const shortest = std::min({width[0], width[1], width[2]});
  return {width[0] < 1.5 * shortest, width[1] < 1.5 * shortest, width[2] < 1.5 * shortest};
}

/// The axes to double, one time after the other, until blocks of cells become as wide as they are long.
std::vector<Axes> steps_to_widest(Point const& shape) {
  double const longest = std::max({shape[0], shape[1], shape[2]});
  std::vector<Axes> out;
  for (Point width = shape;;) {
    Axes doubled = axes_to_double(width);
    for (int d = 0; d < 3; ++d) doubled[d] = doubled[d] && 2 * width[d] <= longest;
    if (doubled == Axes{}) return out;
    for (int d = 0; d < 3; ++d) width[d] *= doubled[d] ? 2 : 1;
    out.push_back(doubled);
  }
}

BlockGrid doubled(BlockGrid const& grid, int number, Axes const& axes) {
  BlockGrid out{grid.level, grid.width};
  out.own = number;
  for (int d = 0; d < 3; ++d) {
    out.shift[d] = axes[d] ? 1 : 0;
    out.width[d] <<= out.shift[d];
  }
  return out;
}

}  // namespace

Cell widest_blocks(Point const& shape) {
  Cell out{block_edge, block_edge, block_edge};
  for (Axes const& axes : steps_to_widest(shape))
    for (int d = 0; d < 3; ++d) out[d] *= axes[d] ? 2 : 1;
  return out;
}

BlockGrids::BlockGrids(Lattice const& lattice, int finest) : cells_(lattice.cells), leaves_(std::size_t(finest) + 1) {
  Point const shape = lattice.shape();
  auto const last = [this] { return count() - 1; };
  auto const add = [this](BlockGrid const& grid) {
    grids_.push_back(grid);
    for (int child : {grid.finer, grid.own})
      if (child >= 0) grids_[std::size_t(child)].parent = count() - 1;
  };
  auto const steps = steps_to_widest(shape);
  for (int level = finest, finer = -1; level >= 0; --level) {
    leaves_[std::size_t(level)] = count();
    add({level, {block_edge, block_edge, block_edge}});
    for (Axes const& axes : steps) add(doubled(grids_.back(), last(), axes));
    if (finer >= 0) {
      BlockGrid joined{level, grids_.back().width};
      joined.finer = finer;
      joined.own = last();
      add(joined);
    }
    finer = last();
  }
  Point width;
  for (int d = 0; d < 3; ++d) width[d] = shape[d] * grids_.back().width[d];
  while (extent(last()) != Cell{1, 1, 1}) {
    Axes const axes = axes_to_double(width);
    for (int d = 0; d < 3; ++d) width[d] *= axes[d] ? 2 : 1;
    add(doubled(grids_.back(), last(), axes));
  }
}

int BlockGrids::with_at_most(int blocks) const {
  int out = count() - 1;
  for (int g = count() - 1; g >= 0; g = grids_[std::size_t(g)].own) {
    Cell const n = extent(g);
    if (std::int64_t(n[0]) * n[1] * n[2] > blocks) break;
    out = g;
    if (grids_[std::size_t(g)].finer >= 0) break;  // what lies below holds a part of the charge
  }
  return out;
}

Cell BlockGrids::extent(int number) const {
  BlockGrid const& grid = (*this)[number];
  Cell out;
  for (int d = 0; d < 3; ++d) out[d] = ((cells_[d] << grid.level) - 1) / grid.width[d] + 1;
  return out;
}

Box BlockGrids::cells(Block const& b) const {
  BlockGrid const& grid = (*this)[b.grid];
  Box out;
  for (int d = 0; d < 3; ++d) {
    out.lower[d] = b.place[d] * grid.width[d];
    out.upper[d] = std::min(out.lower[d] + grid.width[d], cells_[d] << grid.level) - 1;
  }
  return out;
}

Block BlockGrids::parent(Block const& b) const {
  int const parent = (*this)[b.grid].parent;
  BlockGrid const& grid = (*this)[parent];
  Block out{parent, b.place};
  for (int d = 0; d < 3; ++d) out.place[d] >>= b.grid == grid.finer ? 1 : grid.shift[d];
  return out;
}

}  // namespace amrpic::freespace
