// In place of all that needs Kokkos, in a build without it.
#include <stdexcept>

#include "base/runtime.hpp"
#include "kokkos/particles.hpp"
#include "solver/kokkos_backend.hpp"

namespace amrpic {

void initialize() {}
void require_kokkos() {}
void finalize() {}
std::string trilinos_version() { return ""; }
std::string kokkos_backend() { return ""; }

TileKernels const& kokkos::tile_kernels() { throw std::invalid_argument("particles by Kokkos need a build with it"); }

std::unique_ptr<Backend> make_kokkos_backend(Problem const&) {
  throw SolverError(
      "backend = \"kokkos\" needs Kokkos, and amrpic was built without it; build it again with AMRPIC_KOKKOS_ROOT, or "
      "set backend to \"matrix-free\"");
}

}  // namespace amrpic
