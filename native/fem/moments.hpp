#pragma once

#include <vector>

#include "base/types.hpp"

namespace amrpic::fem {

/// Least weight of a point, in parts of its volume.
constexpr Real least_weight = 0.01;
constexpr int not_fitted = -1;

struct FittedWeights {
  std::vector<Real> weight;
  /// Of each element: the weights integrate all products x^i y^j z^k with i, j, k up to this exactly; `not_fitted`
  /// where it is not full, and the weights are the volumes.
  std::vector<int> degree;
};

/// The weights nearest to volumes V, which are scaled to add up to the element's, in the sum of (w - V)²/V over its
/// points, that are at least `least_weight` V and exact to the highest degree, up to `highest`, for which there are
/// such weights. Points that share a place count as the one that they make up.
///
/// `first`: where each element's points start, elements + 1 values; `reference`: x, y, z of each from -1 to 1; `full`,
/// of each element: it has points, and they fill it; others keep volumes.
FittedWeights fit_moments(std::vector<std::int64_t> const& first, Real const* reference, Real const* volume,
                          bool const* full, Real element_volume, int highest);

}  // namespace amrpic::fem
