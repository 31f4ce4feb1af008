#include "particle/locate.hpp"

#include <cmath>

namespace amrpic {

Locator::Locator(std::shared_ptr<Hierarchy const> hierarchy) : hierarchy_(std::move(hierarchy)), block_shift_(-1) {
  Domain const& domain = hierarchy_->domain();
  for (int d = 0; d < 3; ++d) {
    lower_[d] = domain.lower[d];
    cells_per_metre_[d] = 1 / domain.spacing(d);
  }
  for (int block = hierarchy_->blocking_factor(); block > 1; block /= 2) ++block_shift_;
  for (int l = 0; l < hierarchy_->level_count(); ++l)
    children_.emplace_back(std::size_t(hierarchy_->level(l).box_count()));
}

bool Locator::wrap(Real3& x) const {
  auto const inside = [&](int d) {
    Real const s = (x[d] - lower_[d]) * cells_per_metre_[d];
    return s >= 0 && s < hierarchy_->domain().cells[d];
  };
  for (int d = 0; d < 3; ++d) {
    if (inside(d)) continue;
    if (!hierarchy_->domain().periodic(d)) {
      if (!(x[d] >= lower_[d] && x[d] <= hierarchy_->domain().upper[d])) return false;
      while (!inside(d)) x[d] = std::nextafter(x[d], lower_[d]);  // on the upper wall, or rounded onto it
      continue;
    }
    x[d] = wrapped(x[d], lower_[d], hierarchy_->domain().upper[d]);
    if (!inside(d)) x[d] = lower_[d];  // its coordinate is rounded onto the upper face, which is the lower one
  }
  return true;
}

Home Locator::find(Real3 const& x, Home const& hint) {
  auto const cell_on = [&](int level) {
    Real3 const s = coordinates(level)(x);
    return Index3{int(s[0]), int(s[1]), int(s[2])};
  };
  Home home{hint.level, hint.box, -1};
  Index3 cell = cell_on(home.level);
  if (home.box < 0 || !hierarchy_->level(home.level).box(home.box).contains(cell)) {
    home.level = 0;
    cell = cell_on(0);
    home.box = hierarchy_->level(0).find(cell);
  }
  for (int child = child_box(home.level, home.box, cell); child >= 0; child = child_box(home.level, home.box, cell)) {
    home.box = child;
    cell = cell_on(++home.level);
  }
  home.brick = Bricks(hierarchy_->level(home.level).box(home.box)).number(cell);
  return home;
}

std::vector<char> Locator::refined_bricks(int level, int box) {
  if (!hierarchy_->has_finer(level)) return {};
  auto const& children = this->children(level, box);
  if (children.size() == 1 && children[0] < 0) return {};
  Bricks const bricks(hierarchy_->level(level).box(box));
  std::vector<char> out(std::size_t(bricks.count()), 0);
  for (int b = 0; b < bricks.count(); ++b) out[std::size_t(b)] = is_refined({level, box, b});
  return out;
}

bool Locator::is_refined(Home const& brick) {
  int const size = 1 << block_shift_;
  bool out = false;
  for_each_cell(
      Bricks(hierarchy_->level(brick.level).box(brick.box))[brick.brick].coarsen({size, size, size}),
      [&](Index3 const& block) {
        out = out || child_box(brick.level, brick.box, {size * block[0], size * block[1], size * block[2]}) >= 0;
      });
  return out;
}

std::vector<int> const& Locator::children(int level, int box) {
  std::vector<int>& out = children_[level][box];
  if (out.empty()) out = make_children(level, box);
  return out;
}

int Locator::child_box(int level, int box, Index3 const& cell) {
  if (!hierarchy_->has_finer(level)) return -1;
  std::vector<int> const& children = this->children(level, box);
  if (children.size() == 1) return children[0];
  Box const& parent = hierarchy_->level(level).box(box);
  auto const block = [&](int d) { return (cell[d] - parent.lower[d]) >> block_shift_; };
  auto const blocks = [&](int d) { return ((parent.extent(d) - 1) >> block_shift_) + 1; };  // the last may be shorter
  return children[std::size_t(block(0) + blocks(0) * (block(1) + blocks(1) * block(2)))];
}

std::vector<int> Locator::make_children(int level, int box) const {
  int const size = 1 << block_shift_;
  Box const blocks = hierarchy_->level(level).box(box).coarsen({size, size, size});
  std::vector<int> out(std::size_t(blocks.cells()), -1);
  bool any = false;
  // Boxes start and end on block faces or at a face of the domain, so a block lies in one box or in none.
  hierarchy_->level(level + 1).for_each_overlap(
      hierarchy_->level(level).box(box).refine(refinement_ratio), [&](int child, Box const& part, Index3 const&) {
        any = true;
        for_each_cell(part.coarsen({2 * size, 2 * size, 2 * size}),
                      [&](Index3 const& b) { out[std::size_t(blocks.offset(b))] = child; });
      });
  return any ? out : std::vector<int>{-1};
}

}  // namespace amrpic
