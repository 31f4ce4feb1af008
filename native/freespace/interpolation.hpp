// Polynomials through the values at whole numbers: of potentials far from charge, and of distant charges.
#pragma once

#include <array>

#include "freespace/lane_sums.hpp"

namespace amrpic::freespace {

constexpr int node_count = lane_count;  ///< of an interpolation over an interval
using Nodes = std::array<int, node_count>;

/// Weights of the points -1, 0, 1, 2 for a place in [0, 1] between 0 and 1.
std::array<double, 4> cubic_weights(double place);

/// The second derivatives of these weights.
std::array<double, 4> cubic_curvatures(double place);

/// Eight of the numbers 0 .. extent - 1: all of them, or those next to Chebyshev's nodes; `extent` >= 8.
Nodes chebyshev_points(int extent);

/// Eight whole numbers to interpolate from over an interval: next to each other if it is short.
Nodes nodes_between(double first, double last);

/// Lagrange's weights of the nodes for a place.
std::array<double, node_count> lagrange_weights(Nodes const& nodes, double place);

}  // namespace amrpic::freespace
