#pragma once

#include <algorithm>
#include <limits>
#include <vector>

#include "particle/bricks.hpp"
#include "particle/locate.hpp"
#include "particle/view.hpp"

namespace amrpic {

/// Cells along x; none if the last is below the first.
struct RowPart {
  int first, last;

  static constexpr RowPart none() { return {std::numeric_limits<int>::max(), std::numeric_limits<int>::min()}; }
  bool empty() const { return last < first; }
  RowPart hull(RowPart const& other) const { return {std::min(first, other.first), std::max(last, other.last)}; }
  RowPart intersect(int from, int to) const { return {std::max(first, from), std::min(last, to)}; }
};

/// Which cells lie near the particles of a box: the bricks that hold any.
class OccupiedRows {
 public:
  OccupiedRows() : OccupiedRows(Box{}) {}
  /// All bricks of a box.
  explicit OccupiedRows(Box const& box) : box_(box), bricks_(box) {
    rows_.assign(std::size_t(bricks_.count(1)) * std::size_t(bricks_.count(2)), {box.lower[0], box.upper[0]});
  }
  /// Those of particles [first, last), sorted by brick.
  OccupiedRows(Box const& box, LevelCoordinates const& coordinates, ParticleView const& particles, std::int64_t first,
               std::int64_t last)
      : box_(box), bricks_(box) {
    rows_.assign(std::size_t(bricks_.count(1)) * std::size_t(bricks_.count(2)), RowPart::none());
    auto const brick_of = [&](int axis, std::int64_t n) {
      std::size_t const d = std::size_t(axis);
      Real const s = coordinates.along(axis, particles.position[d][n]);
      // one that has strayed is found when clouds are read
      return brick(axis, int(std::min(std::max(s, Real(box.lower[d])), Real(box.upper[d]))));
    };
    auto const end_of_brick = [&](int axis, std::int64_t from, std::int64_t to) {  // that of the first particle
      int const first_brick = brick_of(axis, from);
      for (++from; from < to;) {
        std::int64_t const middle = from + (to - from) / 2;
        brick_of(axis, middle) <= first_brick ? from = middle + 1 : to = middle;
      }
      return to;
    };
    // the first and the last particle of a row of bricks along x tell which of these hold any
    for (std::int64_t of_plane = first; of_plane < last;) {
      std::int64_t const end = end_of_brick(2, of_plane, last);
      for (std::int64_t of_row = of_plane; of_row < end;) {
        std::int64_t const next = end_of_brick(1, of_row, end);
        RowPart& row = rows_[std::size_t(brick_of(1, of_row) + bricks_.count(1) * brick_of(2, of_row))];
        row = row.hull({first_of(0, brick_of(0, of_row)), last_of(0, brick_of(0, next - 1))});
        of_row = next;
      }
      of_plane = end;
    }
  }

  Box const& box() const { return box_; }

  /// The bricks along z, from the first to the last, that lie within `reach` of plane k; none if it is further away.
  std::array<int, 2> bricks_near_plane(int k, int reach) const { return {brick(2, k - reach), brick(2, k + reach)}; }

  /// For each row from `first` on, the smallest part that holds all cells within `reach` of the occupied bricks among
  /// some along z.
  void parts(std::array<int, 2> const& bricks, int reach, int first, std::vector<RowPart>& out) const {
    std::fill(out.begin(), out.end(), RowPart::none());
    for (int y = 0; y < bricks_.count(1); ++y) {
      RowPart row = RowPart::none();
      for (int z = bricks[0]; z <= bricks[1]; ++z) row = row.hull(rows_[std::size_t(y + bricks_.count(1) * z)]);
      if (row.empty()) continue;
      for (int j = first_of(1, y) - reach; j <= last_of(1, y) + reach; ++j) {
        RowPart& part = out[std::size_t(j - first)];
        part = part.hull({row.first - reach, row.last + reach});
      }
    }
  }

 private:
  int brick(int axis, int cell) const {
    int const at = (cell - box_.lower[std::size_t(axis)]) / brick_shape[std::size_t(axis)];
    return std::max(0, std::min(bricks_.count(axis) - 1, at));
  }
  int first_of(int axis, int brick) const {
    return box_.lower[std::size_t(axis)] + brick * brick_shape[std::size_t(axis)];
  }
  int last_of(int axis, int brick) const {
    return std::min(first_of(axis, brick + 1) - 1, box_.upper[std::size_t(axis)]);
  }

  Box box_;
  Bricks bricks_;
  std::vector<RowPart> rows_;  ///< the hull of the occupied bricks in each row of bricks along x
};

/// The cells of a box and of `reach` layers around it that lie near its particles, plane by plane.
class NearRows {
 public:
  NearRows() = default;
  /// `rows` must outlive it.
  NearRows(OccupiedRows const& rows, int reach) : rows_(&rows), reach_(reach) {
    parts_.resize(std::size_t(rows.box().extent(1) + 2 * reach));
  }

  void go_to_plane(int k) {
    auto const bricks = rows_->bricks_near_plane(k, reach_);
    if (bricks == bricks_) return;
    bricks_ = bricks;
    rows_->parts(bricks, reach_, first_row(), parts_);
    common_ = parts_[0];
    for (RowPart const& part : parts_) common_ = part.intersect(common_.first, common_.last);
  }
  /// Whether cells from `first` to `last` of all rows are near.
  bool holds(int first, int last) const { return first >= common_.first && last <= common_.last; }
  /// Of row j of the plane.
  RowPart const& operator()(int j) const { return parts_[std::size_t(j - first_row())]; }

 private:
  int first_row() const { return rows_->box().lower[1] - reach_; }

  OccupiedRows const* rows_ = nullptr;
  int reach_ = 0;
  std::array<int, 2> bricks_{-1, -1};
  std::vector<RowPart> parts_;  ///< of the rows of the plane under way
  RowPart common_{0, -1};       ///< to all of them
};

}  // namespace amrpic
