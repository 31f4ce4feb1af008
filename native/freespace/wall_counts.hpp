// What the plan of open walls comes to on one rank, any, without charge and without messages.
#pragma once

#include <cstdint>
#include <vector>

#include "freespace/acceptance.hpp"
#include "freespace/wall_plan.hpp"

namespace amrpic::freespace {

/// Corners of a cuboid with charge, in cells of the base.
struct ChargedRegion {
  Point lower, upper;
};

/// Counts of one solve on one rank.
struct WallCounts {
  struct Sent {
    std::int64_t messages = 0, bytes = 0;
  };
  std::int64_t patches = 0;        ///< evaluated
  std::int64_t far = 0, near = 0;  ///< interactions of these: multipoles, and nodes summed one by one
  std::int64_t nodes_received = 0, leaves_received = 0;
  Sent parts, joins, families, leaves, down, walls;  ///< by what is sent, in the order of a solve
  std::int64_t received_messages = 0;
  std::vector<std::int64_t> collectives;  ///< bytes of each
};

/// Every block is taken to be full of charge that has a part in one of the regions, or everywhere without any.
WallCounts count(WallPlan const& plan, Options const& options, std::vector<ChargedRegion> const& charged);

}  // namespace amrpic::freespace
