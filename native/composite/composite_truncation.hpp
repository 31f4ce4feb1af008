#pragma once

#include "composite/composite_residual.hpp"

namespace amrpic {

/// truncation = scale[level] * the truncation error of the operator in uncovered cells; see CompositeLaplacian.
/// Collective.
Real composite_truncation(CompositeMesh& mesh, Source const& source, Field const& phi, Index3 const& base_ratio,
                          std::vector<Real> const& scale, Blocks<float> const& truncation);

}  // namespace amrpic
