#include "mesh/stencil_sums.hpp"

namespace amrpic {

std::vector<Real> stencil_sums(Real const* value, std::array<std::ptrdiff_t, 3> const& steps,
                               std::vector<std::int64_t> const& place, std::vector<std::int64_t> const& kind,
                               SharedStencils const& stencils) {
  std::size_t const rows = stencils.rows;
  std::vector<Real> out(place.size() * rows, 0.0);
  for (std::size_t c = 0; c < place.size(); ++c) {
    Real const* const here = value + place[c];
    Real* const sum = out.data() + c * rows;
    for (std::int64_t e = stencils.first[kind[c]]; e < stencils.first[kind[c] + 1]; ++e) {
      int const* const offset = stencils.offset + 3 * e;
      Real const difference = here[offset[0] * steps[0] + offset[1] * steps[1] + offset[2] * steps[2]] - *here;
      Real const* const weight = stencils.weight + std::size_t(e) * rows;
      for (std::size_t r = 0; r < rows; ++r) sum[r] += weight[r] * difference;
    }
  }
  return out;
}

}  // namespace amrpic
