#pragma once

#include "base/types.hpp"

namespace amrpic {

/// Where phi_2 is not known, see `interface_ghost`, the line through phi* and phi_1.
namespace linear_ghost {
constexpr Real coarse = 2.0 / 3.0;
constexpr Real first = 1.0 / 3.0;
}  // namespace linear_ghost

}  // namespace amrpic
