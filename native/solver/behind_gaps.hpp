#pragma once

#include <array>

#include "base/types.hpp"

namespace amrpic {

/// Factors of the Jacobi steps that coarse cells behind faces with fits in narrow gaps take after each cycle that is
/// accelerated, with the composite residual over the plain diagonal.
///
/// A cycle sees the flux between two cells of the coarser level as the difference of their values. With a fit it is
/// less for errors that change sign from cell to cell, since the fit takes values from all around: down to a share x of
/// 0.3 on a checkerboard of single blocks of two cells, so that cycles leave 0.7 of such errors, and with the steps (1
/// - x)(1 - x)(1 - 1.8 x), at most 0.23. Larger factors leave less of these, but oscillate where fine cells respond.
constexpr std::array<Real, 2> steps_behind_gaps{1.0, 1.8};

}  // namespace amrpic
