#pragma once

#include <array>

namespace amrpic {

/// Factors of the Jacobi steps that coarse cells behind faces with fits in narrow gaps take after each cycle that is
/// accelerated, with the composite residual over the plain diagonal.
///
/// A cycle sees the flux between two cells of the coarser level as the difference of their values. With a fit it is less
/// for errors that change sign from cell to cell, since the fit takes values from all around: down to 0.3 of that on a
/// checkerboard of single blocks of two cells, so that cycles leave 0.7 of such errors. The two steps leave the least of
/// those that a cycle leaves, (1 - x)(1 - 1.2 x)(1 - 2.5 x) for x from 0.3 to 1.
constexpr std::array<double, 2> steps_behind_gaps{1.2, 2.5};

}  // namespace amrpic
