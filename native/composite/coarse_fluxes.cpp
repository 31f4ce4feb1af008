#include "composite/coarse_fluxes.hpp"

namespace amrpic {

CoarseFluxes::CoarseFluxes(CompositeMesh& mesh) : mesh_(mesh) {
  for (int l = 0; l < mesh_.levels(); ++l) of_level_.emplace_back(std::size_t(mesh_.plan(l).fluxes));
}

void CoarseFluxes::send(int l) {
  mesh_.plan(l - 1).finer_fluxes.start([&](int, Read const& read, Real* out) {
    Real const* const fluxes = of_level_[std::size_t(l)].data();
    mesh_.for_each_flux_row_read(l, read,
                                 [&](std::int32_t first, int count) { out = std::copy_n(fluxes + first, count, out); });
  });
}

std::size_t CoarseFluxes::bytes() const {
  std::size_t values = 0;
  for (auto const& level : of_level_) values += level.capacity();
  return values * sizeof(Real);
}

}  // namespace amrpic
