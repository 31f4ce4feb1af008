// Lists from ranks that need not be expected.
#pragma once

#include <cstdint>
#include <map>
#include <utility>
#include <vector>

#include "base/communicator.hpp"

namespace amrpic {

/// What other ranks have for this one, in the order of ranks; `to` holds what this one has for others. Ranks that have
/// nothing for each other do not meet (T. Hoefler et al., "Scalable communication protocols for dynamic sparse data
/// exchange", PPoPP 2010). Collective.
std::vector<std::pair<int, std::vector<std::int64_t>>> brought(Communicator const& comm,
                                                               std::map<int, std::vector<std::int64_t>> const& to);

}  // namespace amrpic
