// Conductors as the cells of a level see them.
#pragma once

#include <algorithm>
#include <array>
#include <functional>
#include <memory>
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

/// The cut and the solid cells in a region of a level, sorted by z, y, x.
class MetalCells {
 public:
  MetalCells() = default;
  MetalCells(std::vector<CutCell> cut, std::vector<SolidCell> solid) : cut_(std::move(cut)), solid_(std::move(solid)) {}

  std::vector<CutCell> const& cut() const { return cut_; }
  std::vector<SolidCell> const& solid() const { return solid_; }
  bool empty() const { return cut_.empty() && solid_.empty(); }

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
  template <class Cell, class F>
  static void for_each_in_row(std::vector<Cell> const& cells, Index3 const& first, int count, F&& f) {
    auto const before = [](Cell const& a, Index3 const& b) {
      return std::array{a.cell[2], a.cell[1], a.cell[0]} < std::array{b[2], b[1], b[0]};
    };
    auto at = std::lower_bound(cells.begin(), cells.end(), first, before);
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
  /// ask(region, spacing) finds those of a region of cells that starts at the lower corner of the domain; called by one
  /// thread, the same numbers for a cell whatever the region.
  using Ask = std::function<MetalCells(Box const&, Real3 const&)>;
  /// `base`, `spacing`: the cells of the base level.
  Metal(int electrodes, Index3 const& base, Real3 const& spacing, Ask ask)
      : electrodes_(electrodes),
        base_{{0, 0, 0}, {base[0] - 1, base[1] - 1, base[2] - 1}},
        spacing_(spacing),
        ask_(std::move(ask)) {}

  int electrodes() const { return electrodes_; }
  /// The cells in boxes on a level, which may be images behind periodic faces. Walls end arms half-way, and hide metal
  /// behind them. Local.
  MetalCells cells(Level const& level, std::vector<Box> const& boxes) const;
  /// Those of this rank.
  MetalCells own_cells(Level const& level) const;

 private:
  void add_thin(Level const& level, Box const& region, MetalCells& cells) const;

  int electrodes_;
  Box base_;
  Real3 spacing_;
  Ask ask_;
};

}  // namespace amrpic
