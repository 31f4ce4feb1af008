#pragma once

#include <cstdint>
#include <vector>

#include "base/types.hpp"

namespace amrpic {

/// Stencils that many cells share, by kind: those of kind k are the entries from first[k] to first[k + 1].
struct SharedStencils {
  std::int64_t const* first;
  int const* offset;   ///< (entries, 3): cells from the middle one
  Real const* weight;  ///< (entries, rows)
  std::size_t rows;
};

/// Of each cell, the sums of weights times the differences of the values around it from its own: (cells, rows). They do
/// not depend on what other cells are asked for, not even by rounding.
///
/// `value`: a dense array, x fastest, with steps[d] numbers from a cell to the next along an axis; `place`: of the
/// cells in it.
std::vector<Real> stencil_sums(Real const* value, std::array<std::ptrdiff_t, 3> const& steps,
                               std::vector<std::int64_t> const& place, std::vector<std::int64_t> const& kind,
                               SharedStencils const& stencils);

}  // namespace amrpic
