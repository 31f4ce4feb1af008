#pragma once

#include "mesh/field.hpp"

namespace amrpic {

/// How large a mean density (C/m^3) may be the rounding of numbers from which rho was made by subtraction; 0 if rho
/// bears no sign of that. Collective.
///
/// The difference of two doubles of like size is a multiple of the last binary digit of the smaller one. So where a
/// uniform density was cancelled by hand, all values are multiples of one power of two u, and the numbers that
/// cancelled were at most 2^53 u. What a mean misses by is some of these units, about the root of the number of cells.
/// Round numbers such as 1 or 0.25 are multiples of a large u without any rounding; so no more is granted than is lost
/// by densities up to about 1e7 C/m^3.
Real rounding_of_subtraction(Field const& rho);

}  // namespace amrpic
