#include "multigrid/semicoarse.hpp"

#include <algorithm>
#include <limits>
#include <map>
#include <set>

#include "mesh/box_set.hpp"
#include "stencil/interface.hpp"

namespace amrpic {

namespace {

/// Which cells a refinement level has when it is semicoarsened, with `size` of the level's per cell along each axis.
/// Corrections vanish at walls and one of the level's own cells outside its faces, at the centres of the coarser
/// level's cells.
///
/// No gap of the level may be lost in larger cells: it holds corrections, and where nothing else does, a level without
/// it overshoots by factors of ten and more. So a cell that would bridge a gap is left out. The gap is then too wide
/// and corrections too small, which does no harm.
class SemicoarseCells {
 public:
  SemicoarseCells(std::shared_ptr<Level const> level, Faces const& boundary, Index3 const& size, Box const& domain)
      : level_(std::move(level)), boundary_(boundary), size_(size), domain_(domain) {
    for (int d = 0; d < 3; ++d) {
      whole_[d] = size[d] > 1 && domain.extent(d) == 1 && is_closed(boundary[d]);
      reach_[d] = size[d] > 1 && !whole_[d];
    }
  }

  /// The cells to keep, as disjoint boxes.
  std::vector<Box> kept() const {
    std::vector<Box> out;
    std::set<Index3> tried;
    std::map<Index3, bool> known;  // whether a cell bridges a gap
    for (int b = 0; b < level_->box_count(); ++b) {
      Box const candidates = level_->box(b).coarsen(size_).intersect(domain_);
      std::vector<Box> rest{candidates}, own{surely_kept(b)};
      if (candidates.empty()) continue;
      for_each_cell(candidates, [&](Index3 const& cell) {
        if (level_->box(b).contains(cells_in(cell))) return;
        auto const [at, fresh] = known.emplace(cell, false);
        if (fresh) at->second = bridges_gap(cell);
        if (!at->second) return;
        rest = without(rest, {cell, cell});
        own = without(own, {cell, cell});
      });
      level_->for_each_overlap(candidates.refine(size_).grow(reach_), [&](int other, Box const&, Index3 const&) {
        rest = without(rest, surely_kept(other));
        if (other < b) own = without(own, surely_kept(other));
      });
      for (Box const& box : own)
        if (!box.empty()) out.push_back(box);
      for (Box const& box : rest)
        for_each_cell(box, [&](Index3 const& cell) {
          if (tried.insert(cell).second && covers(core(cell))) out.push_back({cell, cell});
        });
    }
    return joined(out);
  }

  /// How far behind the centre of a cell, in its spacings, corrections vanish on a side where the level ends.
  Real distance(Index3 const& cell, int axis, int side) const {
    Box place = core(cell);
    int const step = side == 0 ? -1 : 1, size = size_[axis];
    int at = side == 0 ? place.lower[axis] : place.upper[axis];
    int const farthest = at + step * size;
    bool in_level = true;  // a narrow gap is reached from both sides, and corrections vanish between its two cells
    for (place.lower[axis] = place.upper[axis] = at + step; at != farthest && covers(place);
         place.lower[axis] = place.upper[axis] = at + step) {
      bool const before = in_level;
      in_level = level_->intersects(place);
      if (!in_level && !before) break;
      at += step;
    }
    Real const centre = (cell[axis] + 0.5) * size, zero = side == 0 ? at : at + 1;
    return std::max(std::abs(zero - centre) / size, 0.25);
  }

 private:
  /// The level's cells within a quarter of a spacing of a cell's centre; inside the domain where half a cell is kept
  /// anyway. All cells along a closed axis where there is one for all of them: it stands for what is constant there.
  Box core(Index3 const& cell) const {
    Box out;
    for (int d = 0; d < 3; ++d) {
      if (whole_[d]) {
        out.lower[d] = level_->domain().lower[d];
        out.upper[d] = level_->domain().upper[d];
        continue;
      }
      out.lower[d] = size_[d] * cell[d] + size_[d] / 4;
      out.upper[d] = size_[d] * (cell[d] + 1) - 1 - size_[d] / 4;
      Boundary const upper = boundary_[d][1];
      if (upper == Boundary::neumann || upper == Boundary::periodic) {
        int const last = level_->domain().upper[d];
        out.lower[d] = std::min(out.lower[d], last);
        out.upper[d] = std::min(out.upper[d], last);
      }
    }
    return out;
  }

  /// The level's indices within a cell, inside the domain.
  Box cells_in(Index3 const& cell) const { return Box{cell, cell}.refine(size_).intersect(level_->domain()); }

  /// Whether a gap of the level lies in a cell, and neither this ends the level on that side nor a wall holds it there.
  bool bridges_gap(Index3 const& cell) const {
    Box const whole = cells_in(cell);
    std::vector<Box> gaps{whole};
    level_->for_each_overlap(whole, [&](int, Box const& part, Index3 const&) { gaps = without(gaps, part); });
    return std::any_of(gaps.begin(), gaps.end(), [&](Box const& gap) {
      for (int axis = 0; axis < 3; ++axis) {
        int const middle = cell[axis] * size_[axis] + size_[axis] / 2;
        if (gap.lower[axis] >= middle && ends(cell, axis, 1)) return false;
        if (gap.upper[axis] < middle && ends(cell, axis, 0)) return false;
      }
      return true;
    });
  }

  /// Whether the level ends beside a cell, or a wall holds corrections there.
  bool ends(Index3 cell, int axis, int side) const {
    if (!reach_[axis]) return false;
    cell[axis] += side == 0 ? -1 : 1;
    if (cell[axis] < domain_.lower[axis] || cell[axis] > domain_.upper[axis]) {
      if (!level_->periodic()[axis]) return boundary_[axis][side] != Boundary::neumann;
      cell[axis] = side == 0 ? domain_.upper[axis] : domain_.lower[axis];
    }
    return !covers(core(cell));
  }

  /// A box of the level grown to where corrections vanish.
  Box reached(Box const& box) const { return level_->cut_at_walls(box.grow(reach_)); }

  bool covers(Box const& region) const {
    std::vector<Box> rest{region};
    level_->for_each_overlap(region.grow(reach_), [&](int b, Box const&, Index3 const& shift) {
      if (!rest.empty()) rest = without(rest, reached(level_->box(b).shift(shift)));
    });
    return rest.empty();
  }

  /// Cells whose cores lie in what one box of the level reaches.
  Box surely_kept(int b) const {
    Box const &box = level_->box(b), region = reached(box);
    Box out = box.coarsen(size_).intersect(domain_);
    for (int d = 0; d < 3; ++d) {
      while (out.lower[d] <= out.upper[d] && core(out.lower).lower[d] < region.lower[d]) ++out.lower[d];
      while (out.lower[d] <= out.upper[d] && core(out.upper).upper[d] > region.upper[d]) --out.upper[d];
    }
    return out;
  }

  std::shared_ptr<Level const> level_;
  Faces boundary_;
  Index3 size_;
  Box domain_;  ///< of the semicoarsened level
  Index3 reach_;
  std::array<bool, 3> whole_;
};

/// By how much to semicoarsen each axis of a level: 2 along the axes of smallest spacing, of those that can be
/// coarsened, while another spacing is about twice that; else all ones.
Index3 semicoarsening_of(Level const& level, Faces const& boundary) {
  Real3 const& h = level.spacing();
  auto shortens = [&](int d) { return can_be_coarsened(level.domain().extent(d), boundary[d]); };
  Real finest = std::numeric_limits<Real>::infinity();
  for (int d = 0; d < 3; ++d)
    if (shortens(d)) finest = std::min(finest, h[d]);
  Index3 ratio{1, 1, 1};
  if (!is_long(*std::max_element(h.begin(), h.end()), finest)) return ratio;
  for (int d = 0; d < 3; ++d)
    if (h[d] <= 1.5 * finest && shortens(d)) ratio[d] = 2;
  return ratio;
}

/// A refinement level semicoarsened by `ratio` once more than `above`, of which one cell has `size` of the refinement
/// level's.
SemicoarsenedLevel semicoarsened_of(SemicoarsenedLevel const& above, Index3 size, Index3 const& ratio,
                                    std::shared_ptr<Level const> const& refinement, Faces const& boundary,
                                    int max_grid_size) {
  SemicoarsenedLevel out{0, nullptr, ratio, above.walls, above.upper, {}, {}, {}};
  Box domain = above.level->domain();
  Real3 spacing = above.level->spacing();
  std::array<bool, 3> periodic = above.level->periodic();
  bool one_for_all = false;                          // along a closed axis
  std::array<std::array<Real, 2>, 3> wall_factor{};  // for prolongation
  for (int d = 0; d < 3; ++d) {
    if (ratio[d] == 1) continue;
    int const cells = domain.extent(d);
    CoarseAxis const axis = coarsened(cells, above.upper[d], boundary[d][1], 0);
    out.children[d] = last_children(cells, above.upper[d], boundary[d][1]);
    domain.upper[d] = axis.cells - 1;
    out.upper[d] = axis.end;
    spacing[d] *= 2;
    size[d] *= 2;
    for (int side = 0; side < 2; ++side) {
      UpperEnd const end = side == 0 ? UpperEnd{} : axis.end;
      Boundary const kind = boundary[d][side];
      // an open wall's potential is given half a cell of the refinement level behind it
      Real const open = ghost_that_vanishes(end.wall + 0.5 / size[d]);
      out.walls[d][side] = kind == Boundary::open ? WallGhost{open, 0, 0} : coarse_wall_ghost(kind, axis.cells, end);
      wall_factor[d][side] = kind == Boundary::open ? open : prolonged_wall_ghost(kind, end);
    }
    one_for_all = one_for_all || (axis.cells == 1 && is_closed(boundary[d]));
    periodic[d] = periodic[d] && axis.cells > 1;
  }
  auto const cells = std::make_shared<SemicoarseCells const>(refinement, boundary, size, domain);
  out.ghost = [cells, size](Index3 const& cell, int axis, int side) -> WallGhost {
    if (size[axis] == 1) return {interface_ghost::first, interface_ghost::second, 0};
    return {ghost_that_vanishes(cells->distance(cell, axis, side)), 0, 0};
  };
  DistributedBoxes distributed;
  if (!one_for_all) distributed = halved(*above.level, ratio, domain);
  if (distributed.boxes.empty()) {
    for (Box const& box : cells->kept())
      for (Box const& piece : cut(box, max_grid_size, 1)) distributed.boxes.push_back(piece);
    distributed.first = distribute_along_curve(distributed.boxes, above.level->ranks());
  }
  out.level = std::make_shared<Level const>(domain, periodic, spacing, std::move(distributed.boxes),
                                            std::move(distributed.first), above.level->rank());
  out.prolonged = [ghost = out.ghost, wall_factor, own = out.level](Index3 const& cell, int axis, int side) {
    return own->is_at_wall({cell, cell}, axis, side) ? wall_factor[axis][side] : ghost(cell, axis, side).first;
  };
  return out;
}

}  // namespace

CycleLevels::CycleLevels(MultigridLevels multigrid, int max_grid_size) : MultigridLevels(std::move(multigrid)) {
  for (std::size_t l = base + 1; l < levels.size(); ++l) {
    SemicoarsenedLevel above{l, levels[l], {1, 1, 1}, walls[l], {}, {}, {}, {}};
    Index3 size{1, 1, 1};
    for (Index3 ratio; (ratio = semicoarsening_of(*above.level, boundary)) != Index3{1, 1, 1};) {
      SemicoarsenedLevel next = semicoarsened_of(above, size, ratio, levels[l], boundary, max_grid_size);
      if (next.level->box_count() == 0) break;
      next.finer = above.finer;
      for (int d = 0; d < 3; ++d) size[d] *= ratio[d];
      above = next;
      above.finer = count();
      semicoarsened.push_back(std::move(next));
    }
  }
}

std::vector<std::size_t> CycleLevels::coarser(std::size_t l) const {
  std::vector<std::size_t> out;
  if (l > 0 && l < levels.size()) out.push_back(l - 1);
  for (std::size_t c = levels.size(); c < count(); ++c)
    if (finer(c) == l) out.push_back(c);
  return out;
}

}  // namespace amrpic
