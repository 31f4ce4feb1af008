#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "particle/locate.hpp"

namespace amrpic {

/// Particles of a brick, and its place on the curve of bricks.
struct BrickCount {
  std::int64_t place, count;
};

/// Number of `count` particles of this rank, sorted or not, in each brick that holds any, ascending along the curve;
/// those that are outside the domain are not counted. Local.
std::vector<BrickCount> count_per_brick(Locator& locator, std::array<Real*, 3> const& position, std::int64_t count);

}  // namespace amrpic
