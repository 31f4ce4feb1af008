// For plans: to whom virtual ranks would send.
#pragma once

#include <set>

namespace amrpic {

/// The ranks that virtual ranks of this process have sent messages to, since the set was last cleared.
std::set<int>& destinations();

}  // namespace amrpic
