#pragma once

#include <memory>

#include "solver/backend.hpp"

namespace amrpic {

/// The stencils as Kokkos kernels, each over all rows of a level, in the memory of the execution space. Plans, the
/// coarsest solve, norms of the right-hand side, the estimate of the mesh's error and E are the matrix-free backend's.
/// Without Kokkos: throws SolverError. Collective.
std::unique_ptr<Backend> make_kokkos_backend(Problem const& problem);

}  // namespace amrpic
