#pragma once

#include <vector>

#include "particle/lane_groups.hpp"
#include "particle/locate.hpp"

namespace amrpic {

/// A brick in its level's coordinates, to compare particles with.
struct HomeBrick {
  LevelCoordinates coordinates;
  Real3 lower, upper;

  /// Which of eight particles lie in it.
  WideLanes contains(std::array<Lanes, 3> const& x) const {
    WideLanes in = WideLanes{} - 1;
    for (int d = 0; d < 3; ++d) {
      Lanes const s = coordinates.along(d, x[d]);
      in &= (s >= lower[d]) & (s < upper[d]);
    }
    return in;
  }
};

/// A box, or one brick of it, as a home of particles.
class HomeBox {
 public:
  HomeBox(Locator& locator, int level, int box)
      : HomeBox(locator.coordinates(level), locator.hierarchy().level(level).box(box),
                locator.refined_bricks(level, box)) {}
  HomeBox(Locator& locator, Home const& brick)
      : HomeBox(locator.coordinates(brick.level),
                Bricks(locator.hierarchy().level(brick.level).box(brick.box))[brick.brick],
                {char(locator.is_refined(brick))}) {}

  /// Number of bricks.
  int bricks() const { return bricks_.count(); }

  HomeBrick brick(int number) const {
    Box const brick = bricks_[number];
    HomeBrick out{coordinates_, {}, {}};
    for (int d = 0; d < 3; ++d) out.lower[d] = brick.lower[d], out.upper[d] = brick.upper[d] + 1;
    return out;
  }

  /// The brick where a point lives; -1 if it lies outside the box, or where a finer box may contain it.
  int find(Real3 const& x) const {
    Real3 const s = coordinates_(x);
    Index3 cell;
    for (int d = 0; d < 3; ++d) {
      if (!(s[d] >= lower_[d] && s[d] < upper_[d])) return -1;
      cell[d] = int(s[d]);
    }
    int const out = bricks_.number(cell);
    return refined_.empty() || !refined_[std::size_t(out)] ? out : -1;
  }

  /// The same of eight points at a time.
  IndexLanes find(std::array<Lanes, 3> const& x) const {
    WideLanes in = WideLanes{} - 1;
    Lanes number{};
    for (int d = 2; d >= 0; --d) {
      Lanes const s = coordinates_.along(d, x[d]);
      in &= (s >= lower_[d]) & (s < upper_[d]);
      // `lower_` is a whole number no larger than s, so that the difference is exact, as is an eighth of it.
      number = number * Real(bricks_.count(d)) + round_down((s - lower_[d]) / Real(brick_shape[d]));
    }
    Lanes const none = Lanes{} - 1;  // by name: nvcc ends on a sum as an argument
    auto out = to_index(select(in, number, none));
    for (int i = 0; i < lane_count && !refined_.empty(); ++i)
      if (out[i] >= 0 && refined_[std::size_t(out[i])]) out[i] = -1;
    return out;
  }

  /// On which side of the box a point lies: 0 to 26, x fastest; below, in or above its range along each axis.
  int direction(Real3 const& x) const {
    Real3 const s = coordinates_(x);
    int out = 0;
    for (int d = 2; d >= 0; --d) out = 3 * out + (s[d] < lower_[d] ? 0 : s[d] < upper_[d] ? 1 : 2);
    return out;
  }

 private:
  HomeBox(LevelCoordinates const& coordinates, Box const& cells, std::vector<char> refined)
      : coordinates_(coordinates), bricks_(cells), refined_(std::move(refined)) {
    for (int d = 0; d < 3; ++d) lower_[d] = cells.lower[d], upper_[d] = cells.upper[d] + 1;
  }

  LevelCoordinates coordinates_;
  Real3 lower_, upper_;  ///< corners in those coordinates
  Bricks bricks_;
  std::vector<char> refined_;
};

}  // namespace amrpic
