// Conductors as the cells of a level see them.
#pragma once

#include <algorithm>
#include <array>
#include <functional>
#include <list>
#include <memory>
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

/// Whether a cell comes first by z, y, x.
inline bool comes_before(Index3 const& a, Index3 const& b) {
  return std::array{a[2], a[1], a[0]} < std::array{b[2], b[1], b[0]};
}

/// The cut and the solid cells in a region of a level, sorted by z, y, x.
class MetalCells {
 public:
  MetalCells() = default;
  MetalCells(std::vector<CutCell> cut, std::vector<SolidCell> solid) : cut_(std::move(cut)), solid_(std::move(solid)) {}

  std::vector<CutCell> const& cut() const { return cut_; }
  std::vector<SolidCell> const& solid() const { return solid_; }
  bool empty() const { return cut_.empty() && solid_.empty(); }
  // Null for a cell that is no such one.
  CutCell const* cut_at(Index3 const& cell) const { return find(cut_, cell); }
  SolidCell const* solid_at(Index3 const& cell) const { return find(solid_, cell); }

  /// Call f(cell) for those of a row of `count` cells.
  template <class F>
  void for_each_cut(Index3 const& first, int count, F&& f) const {
    for_each_in_row(cut_, first, count, f);
  }
  template <class F>
  void for_each_solid(Index3 const& first, int count, F&& f) const {
    for_each_in_row(solid_, first, count, f);
  }

 private:
  template <class Cell>
  static auto from(std::vector<Cell> const& cells, Index3 const& first) {
    return std::lower_bound(cells.begin(), cells.end(), first,
                            [](Cell const& a, Index3 const& b) { return comes_before(a.cell, b); });
  }
  template <class Cell>
  static Cell const* find(std::vector<Cell> const& cells, Index3 const& cell) {
    auto const at = from(cells, cell);
    return at != cells.end() && at->cell == cell ? &*at : nullptr;
  }
  template <class Cell, class F>
  static void for_each_in_row(std::vector<Cell> const& cells, Index3 const& first, int count, F&& f) {
    auto at = from(cells, first);
    for (; at != cells.end() && at->cell[2] == first[2] && at->cell[1] == first[1] && at->cell[0] < first[0] + count;
         ++at)
      f(*at);
  }

  std::vector<CutCell> cut_;
  std::vector<SolidCell> solid_;
};

/// Where the conductors of a problem are.
class Metal {
 public:
  /// ask(boxes, spacing) finds those in disjoint boxes of cells, in any order; indices start at the lower corner of the
  /// domain. Called by one thread, the same numbers for a cell whatever the boxes.
  using Ask =
      std::function<std::pair<std::vector<CutCell>, std::vector<SolidCell>>(std::vector<Box> const&, Real3 const&)>;
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
  void add_thin(Level const& level, std::vector<Box> const& regions, std::vector<Level const*> const& finer,
                MetalCells& cells) const;
  void add_holds(Level const& level, Level const& finer, Level const* next, Box const& region,
                 std::vector<Real>& hold) const;

  int electrodes_;
  Ask ask_;
  struct Known {
    Real3 spacing;
    std::vector<Box> boxes;
    MetalCells cells;
  };
  mutable std::list<Known> known_;  // they stay where they are
};

}  // namespace amrpic
