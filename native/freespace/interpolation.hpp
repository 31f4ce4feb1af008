// Six-point Lagrange interpolation on a grid of the plane.
#pragma once

#include <array>
#include <vector>

namespace amrpic::freespace {

constexpr int stencil = 6;  ///< points along an axis

/// Greatest error inside the middle interval, for points one apart and a unit charge (potential 1 / r) at this distance
/// from the middle. A fit to measured errors, from above.
double interpolation_error(double distance);

/// The value at (x, y), in grid steps from the first node. Values are `size[0]` wide.
double interpolate(std::vector<double> const& values, std::array<int, 2> const& size, double x, double y);

/// Values on a grid twice as fine along the lower or the upper axis.
std::vector<double> double_rows(std::vector<double> const& values, int nu, int nv);
std::vector<double> double_columns(std::vector<double> const& values, int nu, int nv);

}  // namespace amrpic::freespace
