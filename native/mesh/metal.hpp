// Conductors as the cells of a level see them.
#pragma once

#include <algorithm>
#include <array>
#include <functional>
#include <list>
#include <memory>
#include <numeric>
#include <utility>
#include <vector>

#include "mesh/level.hpp"
#include "stencil/cut_arms.hpp"

namespace amrpic {

/// A cell outside metal from whose centre the way to that of a neighbour leads through a surface.
struct CutCell {
  Index3 cell;
  std::array<Real, 6> arm;       ///< to the first surface on the way, over the spacing; above 1 where there is none
  std::array<int, 6> electrode;  ///< whose it is, or -1
  Real hold = 0;  ///< on coarse levels: what metal that is too thin for their arms adds to the diagonal, over this

  bool is_cut(std::size_t side) const { return electrode[side] >= 0; }
  bool is_cut() const {
    return std::any_of(electrode.begin(), electrode.end(), [](int number) { return number >= 0; });
  }
  static CutCell uncut(Index3 const& cell, Real hold = 0) {
    return {cell, {2, 2, 2, 2, 2, 2}, {-1, -1, -1, -1, -1, -1}, hold};
  }
};

/// Its arm towards a side.
inline Arm arm_of(CutCell const& cut, std::size_t side) {
  return cut.is_cut(side) ? Arm{cut.arm[side], true, 0, false} : Arm{};
}

/// A cell whose centre lies in metal or on its surface.
struct SolidCell {
  Index3 cell;
  int electrode;
};

/// Such cells in a run along x.
struct SolidCells {
  Index3 first;
  int count;
  int electrode;
};

/// Whether a cell comes first by z, y, x.
inline bool comes_before(Index3 const& a, Index3 const& b) {
  return std::array{a[2], a[1], a[0]} < std::array{b[2], b[1], b[0]};
}

/// Cut cells, or runs of solid ones, sorted by z, y, x, and where each row of them begins.
template <class Run>
class CellRows {
 public:
  CellRows() = default;
  explicit CellRows(std::vector<Run> runs) : runs_(std::move(runs)) {
    for (Run const& run : runs_) {
      Box const cells = box_of(run);
      hull_ = hull_.empty() ? cells : hull_.hull(cells);
    }
    if (runs_.empty()) return;
    first_.assign(std::size_t(hull_.extent(1)) * std::size_t(hull_.extent(2)) + 1, 0);
    for (Run const& run : runs_) ++first_[row_of(box_of(run).lower) + 1];
    std::partial_sum(first_.begin(), first_.end(), first_.begin());
  }

  std::vector<Run> const& all() const { return runs_; }
  Box const& hull() const { return hull_; }
  Run const* find(Index3 const& cell) const {  ///< null if there is none
    if (!hull_.contains(cell)) return nullptr;
    auto const [first, end] = row(cell);
    auto const after = after_place(first, end, cell[0]);
    return after != first && box_of(after[-1]).upper[0] >= cell[0] ? after - 1 : nullptr;
  }
  /// Call f(run) for those that meet a row of `count` cells.
  template <class F>
  void for_each(Index3 const& from, int count, F&& f) const {
    if (!hull_.contains(Index3{hull_.lower[0], from[1], from[2]})) return;
    auto const [first, end] = row(from);
    auto at = after_place(first, end, from[0]);
    if (at != first && box_of(at[-1]).upper[0] >= from[0]) --at;
    for (; at != end && box_of(*at).lower[0] < from[0] + count; ++at) f(*at);
  }

 private:
  static Box box_of(CutCell const& cut) { return {cut.cell, cut.cell}; }
  static Box box_of(SolidCells const& run) {
    return {run.first, {run.first[0] + run.count - 1, run.first[1], run.first[2]}};
  }
  std::size_t row_of(Index3 const& cell) const {
    return std::size_t(cell[1] - hull_.lower[1]) + std::size_t(hull_.extent(1)) * std::size_t(cell[2] - hull_.lower[2]);
  }
  std::pair<Run const*, Run const*> row(Index3 const& cell) const {
    std::size_t const n = row_of(cell);
    return {runs_.data() + first_[n], runs_.data() + first_[n + 1]};
  }
  /// The first that begins after a place along x.
  static Run const* after_place(Run const* first, Run const* end, int x) {
    return std::upper_bound(first, end, x, [](int place, Run const& run) { return place < box_of(run).lower[0]; });
  }

  std::vector<Run> runs_;
  Box hull_;
  std::vector<std::int32_t> first_;  ///< of each row of the hull, y fastest, and the end
};

/// The cut and the solid cells in a region of a level, sorted by z, y, x. Copies share them.
class MetalCells {
 public:
  MetalCells() : MetalCells({}, {}) {}
  MetalCells(std::vector<CutCell> cut, std::vector<SolidCells> solid)
      : cut_(std::make_shared<CellRows<CutCell>>(std::move(cut))),
        solid_(std::make_shared<CellRows<SolidCells>>(std::move(solid))) {}

  std::vector<CutCell> const& cut() const { return cut_->all(); }
  std::vector<SolidCells> const& solid() const { return solid_->all(); }
  bool empty() const { return cut().empty() && solid().empty(); }
  /// The smallest box with all of them.
  Box hull() const {
    Box const &cut = cut_->hull(), &solid = solid_->hull();
    return cut.empty() ? solid : solid.empty() ? cut : cut.hull(solid);
  }
  /// The same solid cells with others that are cut.
  MetalCells with(std::vector<CutCell> cut) const {
    MetalCells out = *this;
    out.cut_ = std::make_shared<CellRows<CutCell>>(std::move(cut));
    return out;
  }
  // Null for a cell that is no such one.
  CutCell const* cut_at(Index3 const& cell) const { return cut_->find(cell); }
  SolidCells const* solid_at(Index3 const& cell) const { return solid_->find(cell); }

  /// Call f(cell) for those of a row of `count` cells.
  template <class F>
  void for_each_cut(Index3 const& first, int count, F&& f) const {
    cut_->for_each(first, count, f);
  }
  template <class F>
  void for_each_solid(Index3 const& first, int count, F&& f) const {
    solid_->for_each(first, count, [&](SolidCells const& run) {
      int const begin = std::max(first[0], run.first[0]), end = std::min(first[0] + count, run.first[0] + run.count);
      for (int i = begin; i < end; ++i) f(SolidCell{{i, first[1], first[2]}, run.electrode});
    });
  }

 private:
  std::shared_ptr<CellRows<CutCell> const> cut_;
  std::shared_ptr<CellRows<SolidCells> const> solid_;
};

/// Where the conductors of a problem are.
class Metal {
 public:
  /// ask(boxes, spacing) finds those in disjoint boxes of cells, in any order; indices start at the lower corner of the
  /// domain. Called by one thread, the same numbers for a cell whatever the boxes.
  using Ask =
      std::function<std::pair<std::vector<CutCell>, std::vector<SolidCells>>(std::vector<Box> const&, Real3 const&)>;
  Metal(int electrodes, Ask ask) : electrodes_(electrodes), ask_(std::move(ask)) {}

  int electrodes() const { return electrodes_; }
  /// The cells in boxes on a level, which may be images behind periodic faces, and perhaps others. Walls end arms
  /// half-way, and hide metal behind them. `finer`: levels that see metal which is too thin for this one, coarse to
  /// fine. Local.
  MetalCells cells(Level const& level, std::vector<Box> const& boxes,
                   std::vector<Level const*> const& finer = {}) const;
  /// Those of this rank, and so many cells around them.
  static constexpr int reach = 3;
  MetalCells own_cells(Level const& level) const;
  /// What was found once is not looked for again until then.
  void forget() const { known_.clear(); }

 private:
  MetalCells const& found(std::vector<Box> const& boxes, Real3 const& spacing) const;
  MetalCells with_thin(Level const& level, std::vector<Box> const& regions, std::vector<Level const*> const& finer,
                       MetalCells const& cells) const;
  struct Hold {
    Index3 cell;
    Real share;
  };
  void add_holds(Level const& level, Level const& finer, Level const* next, std::vector<Box> const& regions,
                 MetalCells const& cells, std::vector<Hold>& to) const;

  int electrodes_;
  Ask ask_;
  struct Known {
    Real3 spacing;
    BoxTable boxes;
    MetalCells cells;
  };
  mutable std::list<Known> known_;  // they stay where they are
};

}  // namespace amrpic
