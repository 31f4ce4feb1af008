#pragma once

#include "base/types.hpp"

namespace amrpic {

constexpr Real speed_of_light = 299792458;              ///< m/s
constexpr Real vacuum_permittivity = 8.8541878188e-12;  ///< F/m, CODATA 2022

}  // namespace amrpic
