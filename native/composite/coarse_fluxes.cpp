#include "composite/coarse_fluxes.hpp"

namespace amrpic {

CoarseFluxes::CoarseFluxes(CompositeMesh& mesh) : mesh_(mesh) {
  for (int l = 0; l < mesh_.levels(); ++l) of_level_.emplace_back(std::size_t(mesh_.plan(l).fluxes));
}

void CoarseFluxes::send(int l) {
  mesh_.plan(l - 1).finer_fluxes.start([&](int, Read const& read, Real* out) {
    int const face = read.region % 6, b = read.owner - mesh_.level(l).first_local_box();
    auto const [u, v] = tangential_axes(face / 2);
    Box const part = read.cells();
    Interface const& i = mesh_.plan(l).interfaces[std::size_t(mesh_.plan(l, b).faces[std::size_t(face)].interface)];
    Box const parents = mesh_.box(l, b).coarsen(refinement_ratio);
    for (int y = part.lower[v]; y <= part.upper[v]; ++y)
      out = std::copy_n(row(l, i, y - parents.lower[v] - i.v) + (part.lower[u] - parents.lower[u] - i.u),
                        part.extent(u), out);
  });
}

std::size_t CoarseFluxes::bytes() const {
  std::size_t values = 0;
  for (auto const& level : of_level_) values += level.capacity();
  return values * sizeof(Real);
}

}  // namespace amrpic
