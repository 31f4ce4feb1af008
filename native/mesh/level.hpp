#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "mesh/box_table.hpp"
#include "mesh/domain.hpp"

namespace amrpic {

/// The boxes of one level of resolution, known in full on every rank; the cells of a box live on its owner alone.
///
/// Cells are numbered box by box, x fastest inside a box. Each rank owns a contiguous run of boxes, so its cells are
/// the contiguous range [first_cell(rank), first_cell(rank + 1)) and field memory needs no look-up.
class Level {
 public:
  /// `boxes` are disjoint and in their final order; `first_box[r]` is where rank r's run of boxes starts (ranks + 1
  /// values).
  Level(Box domain, std::array<bool, 3> periodic, Real3 spacing, std::vector<Box> boxes, std::vector<int> first_box,
        int rank);
  /// The same with boxes that another level may share.
  Level(Box domain, std::array<bool, 3> periodic, Real3 spacing, std::shared_ptr<BoxTable const> table,
        std::vector<int> first_box, int rank);

  Box const& domain() const { return domain_; }
  std::array<bool, 3> const& periodic() const { return periodic_; }

  // Walls are the faces of the domain across axes that are not periodic.
  /// Whether a face of a box, side 0 or 1 of an axis, lies on a wall.
  bool is_at_wall(Box const& box, int axis, int side) const {
    return !periodic_[axis] &&
           (side == 0 ? box.lower[axis] == domain_.lower[axis] : box.upper[axis] == domain_.upper[axis]);
  }
  /// Whether a cell lies behind a wall across an axis.
  bool is_behind_wall(Index3 const& cell, int axis) const {
    return !periodic_[axis] && (cell[axis] < domain_.lower[axis] || cell[axis] > domain_.upper[axis]);
  }
  /// The cell itself, or the cell at the wall that is nearest to one behind it.
  Index3 fold_at_walls(Index3 cell) const {
    for (int d = 0; d < 3; ++d)
      if (!periodic_[d]) cell[d] = std::max(domain_.lower[d], std::min(domain_.upper[d], cell[d]));
    return cell;
  }
  /// The cell itself, or the cell in the domain that one behind a periodic face is an image of.
  Index3 wrapped(Index3 cell) const {
    for (int d = 0; d < 3; ++d)
      if (periodic_[d]) cell[d] -= floor_divide(cell[d] - domain_.lower[d], domain_.extent(d)) * domain_.extent(d);
    return cell;
  }
  /// The part of a box that lies behind no wall.
  Box cut_at_walls(Box box) const {
    for (int d = 0; d < 3; ++d) {
      if (periodic_[d]) continue;
      box.lower[d] = std::max(box.lower[d], domain_.lower[d]);
      box.upper[d] = std::min(box.upper[d], domain_.upper[d]);
    }
    return box;
  }

  Real3 const& spacing() const { return spacing_; }
  /// The same boxes on the same ranks, with `factor` times the spacing.
  std::shared_ptr<Level const> stretched(Real3 const& factor) const;
  /// The same as another rank has it.
  std::shared_ptr<Level const> seen_by(int rank) const;
  Real cell_volume() const { return spacing_[0] * spacing_[1] * spacing_[2]; }

  int box_count() const { return table_->count(); }
  std::vector<Box> const& boxes() const { return table_->boxes(); }
  Box const& box(int b) const { return table_->box(b); }
  std::shared_ptr<BoxTable const> const& share_table() const { return table_; }
  int ranks() const { return int(owners_->first_box.size()) - 1; }
  int rank() const { return rank_; }
  int owner(int b) const;
  int owner_of_cell(GlobalIndex cell) const { return owner(table_->box_of_cell(cell)); }

  /// Boxes of this rank: [first_local_box, last_local_box).
  int first_local_box() const { return first_box(rank_); }
  int last_local_box() const { return first_box(rank_ + 1); }
  int first_box(int rank) const { return owners_->first_box[std::size_t(rank)]; }
  int ranks_in_use() const { return owners_->in_use; }  ///< those that have cells

  GlobalIndex cells() const { return table_->cells(); }
  GlobalIndex box_offset(int b) const { return table_->offset(b); }  ///< number of its first cell
  GlobalIndex first_cell(int rank) const { return box_offset(first_box(rank)); }
  GlobalIndex first_local_cell() const { return first_cell(rank_); }
  bool owns(GlobalIndex cell) const { return cell >= first_cell(rank_) && cell < first_cell(rank_ + 1); }
  LocalIndex local_cells() const { return LocalIndex(first_cell(rank_ + 1) - first_cell(rank_)); }
  LocalIndex local_offset(int b) const { return LocalIndex(box_offset(b) - first_local_cell()); }  ///< of a local box

  /// Box that holds a cell inside the domain, or -1.
  int find(Index3 const& cell) const { return table_->find(cell); }

  /// Call `f(b, part, shift)` for each box b and periodic image that meets `region`: `part` is the common part in
  /// region's indices, and `part` minus `shift` lies inside box b. Images of non-periodic axes are not visited.
  /// Ascending in b for each image.
  template <class F>
  void for_each_overlap(Box const& region, F&& f) const {
    for (auto const& shift : images(region)) {
      for (int b : table_->meeting(region.shift_back(shift).intersect(domain_)))
        f(b, region.intersect(box(b).shift(shift)), shift);
    }
  }

  /// Whether another level has the same cells on the same ranks, in the same space.
  bool same_as(Level const& other) const;

  bool intersects(Box const& region) const { return cells_in(region) > 0; }
  /// How many cells of a region the level has, periodic images counted each.
  GlobalIndex cells_in(Box const& region) const;

 private:
  /// Shifts by whole domains under which `region` can meet the domain.
  std::vector<Index3> images(Box const& region) const;

  Box domain_;
  std::array<bool, 3> periodic_;
  Real3 spacing_;
  std::shared_ptr<BoxTable const> table_;
  /// The same for all ranks, and shared by the levels that differ in nothing else.
  struct Owners {
    std::vector<int> first_box;  ///< ranks + 1 values
    int in_use = 0;
  };
  std::shared_ptr<Owners const> owners_;
  int rank_;
};

/// Whether one spacing is so much longer than another that relaxing does not couple cells along it.
inline bool is_long(Real spacing, Real other) { return spacing > 1.8 * other; }

/// Whether the cells of a level are so long or flat, more than 1.8 to 1, that relaxing points is not enough to smooth
/// it.
bool has_long_cells(Level const& level);

}  // namespace amrpic
