// For plans: to whom virtual ranks would send.
#pragma once

#include <cstdint>
#include <map>

namespace amrpic {

/// The ranks that virtual ranks of this process have sent messages to, and how many bytes, since this was last cleared.
std::map<int, std::int64_t>& destinations();

}  // namespace amrpic
