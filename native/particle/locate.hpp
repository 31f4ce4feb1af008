#pragma once

#include <memory>
#include <tuple>
#include <vector>

#include "mesh/hierarchy.hpp"
#include "particle/bricks.hpp"

namespace amrpic {

/// Where a particle lives: the finest box that holds it, and the brick of that box.
struct Home {
  int level = 0;
  int box = -1;
  int brick = -1;

  bool operator==(Home const& other) const { return level == other.level && box == other.box && brick == other.brick; }
  bool operator<(Home const& other) const {
    return std::tie(level, box, brick) < std::tie(other.level, other.box, other.brick);
  }
};

/// A level's coordinates: cell widths from the lower corner of the domain.
struct LevelCoordinates {
  Real3 lower, cells_per_metre;

  /// Of one number, or on the host of several at a time: no function of a device, which constant ones are as needed.
  template <class T>
  constexpr T along(int axis, T const& x) const {
    return (x - lower[std::size_t(axis)]) * cells_per_metre[std::size_t(axis)];
  }
  KOKKOS_INLINE_FUNCTION Real3 operator()(Real3 const& x) const {
    return {along(0, x[0]), along(1, x[1]), along(2, x[2])};
  }
};

/// Finds the homes of points.
///
/// A point on a face belongs to the cell above it. All levels take their cells from the same base coordinate, scaled by
/// powers of two, so levels cannot disagree by rounding about who holds a point.
class Locator {
 public:
  explicit Locator(std::shared_ptr<Hierarchy const> hierarchy);

  Hierarchy const& hierarchy() const { return *hierarchy_; }

  /// Bring a point into the domain along periodic axes; false if it lies outside along another axis. A point on an
  /// upper wall is inside, as one on a lower wall is: it moves to the next number below, where the last cell holds it.
  bool wrap(Real3& x) const;

  /// Home of a point inside the domain. `hint` is tried first: neighbours in memory are mostly neighbours in space.
  Home find(Real3 const& x, Home const& hint = {});

  /// For each brick of a box, whether a finer box overlaps it; empty if none overlaps the box.
  std::vector<char> refined_bricks(int level, int box);
  bool is_refined(Home const& brick);  ///< the same of one

  LevelCoordinates coordinates(int level) const {
    Real const scale = Real(1 << level);
    return {lower_, {cells_per_metre_[0] * scale, cells_per_metre_[1] * scale, cells_per_metre_[2] * scale}};
  }

 private:
  std::vector<int> const& children(int level, int box);
  int child_box(int level, int box, Index3 const& cell);
  std::vector<int> make_children(int level, int box) const;

  std::shared_ptr<Hierarchy const> hierarchy_;
  Real3 lower_, cells_per_metre_;
  int block_shift_;  ///< a block of the finer level covers 2^block_shift_ cells along an axis
  /// children_[level][box]: box of the finer level, or -1, for each block; empty until asked for, one -1 if none is
  /// finer.
  std::vector<std::vector<std::vector<int>>> children_;
};

}  // namespace amrpic
