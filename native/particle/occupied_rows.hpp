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
    rows_.assign(std::size_t(bricks_.count(1)) * std::size_t(bricks_.count(2)), none);
    auto const brick_of = [&](std::int64_t n) {
      Real3 const s = coordinates(particles.at(n));
      Index3 cell;
      for (int d = 0; d < 3; ++d)  // one that has strayed is found when clouds are read
        cell[d] = int(std::min(std::max(s[d], Real(box.lower[d])), Real(box.upper[d])));
      return bricks_.number(cell);
    };
    while (first < last) {
      int const brick = brick_of(first);
      mark(brick);
      std::int64_t next = last;
      for (std::int64_t low = first + 1; low < next;) {
        std::int64_t const middle = low + (next - low) / 2;
        brick_of(middle) <= brick ? low = middle + 1 : next = middle;
      }
      first = next;
    }
  }

  /// The smallest part of a row of cells that holds all within `reach` of the occupied bricks.
  RowPart near(int j, int k, int reach) const {
    RowPart out = none;
    for (int z = brick(2, k - reach); z <= brick(2, k + reach); ++z)
      for (int y = brick(1, j - reach); y <= brick(1, j + reach); ++y) {
        RowPart const& row = rows_[std::size_t(y + bricks_.count(1) * z)];
        if (!is_near(1, y, j, reach) || !is_near(2, z, k, reach) || row.last < row.first) continue;
        out = {std::min(out.first, row.first - reach), std::max(out.last, row.last + reach)};
      }
    return out;
  }

 private:
  static constexpr RowPart none{std::numeric_limits<int>::max(), std::numeric_limits<int>::min()};

  int brick(int axis, int cell) const {
    int const at = (cell - box_.lower[std::size_t(axis)]) / brick_shape[std::size_t(axis)];
    return std::max(0, std::min(bricks_.count(axis) - 1, at));
  }
  bool is_near(int axis, int brick, int cell, int reach) const {
    int const first = box_.lower[std::size_t(axis)] + brick * brick_shape[std::size_t(axis)];
    int const last = std::min(first + brick_shape[std::size_t(axis)] - 1, box_.upper[std::size_t(axis)]);
    return cell >= first - reach && cell <= last + reach;
  }
  void mark(int number) {
    Box const cells = bricks_[number];
    RowPart& row = rows_[std::size_t(number / bricks_.count(0))];
    row = {std::min(row.first, cells.lower[0]), std::max(row.last, cells.upper[0])};
  }

  Box box_;
  Bricks bricks_;
  std::vector<RowPart> rows_;  ///< the hull of the occupied bricks in each row of bricks along x
};

}  // namespace amrpic
