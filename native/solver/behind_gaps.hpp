#pragma once

#include <array>
#include <type_traits>
#include <vector>

#include "mesh/fits_behind.hpp"
#include "mesh/hierarchy.hpp"

namespace amrpic {

/// Factors of the Jacobi steps that coarse cells behind faces with fits in narrow gaps take after each cycle that is
/// accelerated, with the composite residual over the diagonal of their level's own equations: at walls it is larger,
/// and with that of cells elsewhere such steps would overshoot there.
///
/// A cycle sees the flux between two cells of the coarser level as the difference of their values. With a fit it is
/// less for errors that change sign from cell to cell, since the fit takes values from all around: down to a share x of
/// 0.3 on a checkerboard of single blocks of two cells, so that cycles leave 0.7 of such errors, and with the steps (1
/// - x)(1 - x)(1 - 1.8 x), at most 0.23. Larger factors leave less of these, but oscillate where fine cells respond.
constexpr std::array<Real, 2> steps_behind_gaps{1.0, 1.8};

/// What of(level, box, cell) says of this rank's cells of those, for each level; empty if no rank has any. Collective.
template <class Of>
auto each_behind_gaps(Hierarchy const& hierarchy, Of&& of) {
  std::vector<std::vector<std::invoke_result_t<Of, int, int, Index3 const&>>> out(std::size_t(hierarchy.level_count()));
  Real found = 0;
  for (int l = 0; hierarchy.has_finer(l); ++l)
    for (auto const& [box, cell] : cells_behind_gaps(hierarchy.level(l), hierarchy.level(l + 1))) {
      out[std::size_t(l)].push_back(of(l, box, cell));
      found = 1;
    }
  if (hierarchy.comm().largest(found) == 0) out.clear();
  return out;
}

}  // namespace amrpic
