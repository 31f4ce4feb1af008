// Charge in the first layers of cells before a Dirichlet wall, as seen from afar.
#pragma once

#include <array>

namespace amrpic {

/// What charge in the first, second and third layer counts, of the dipole that it makes with its odd image: the ghost
/// of the wall, a parabola through it, gives the first one no more. Further layers count in full.
constexpr std::array<double, 3> of_image{3.0 / 4, 1, 1};
/// The same in fourth order, for means over cells.
constexpr std::array<double, 3> of_image_in_fourth_order{0.7560, 1.0239, 1.0010};

}  // namespace amrpic
