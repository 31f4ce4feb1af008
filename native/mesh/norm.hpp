#pragma once

#include <mpi.h>

#include <cmath>
#include <limits>

#include "base/types.hpp"

namespace amrpic {

/// Norms over cells; l1 and l2 are weighted by volume.
enum class Norm { l1, l2, max };

/// The norm over all ranks from each one's part: its largest magnitude, or its sum of volumes times magnitudes or their
/// squares. nan if a part is not finite. Collective.
inline Real global_norm(MPI_Comm comm, Norm norm, Real part) {
  // MPI_MAX may drop a nan
  int bad = !std::isfinite(part);
  MPI_Allreduce(MPI_IN_PLACE, &bad, 1, MPI_INT, MPI_MAX, comm);
  if (bad) return std::numeric_limits<Real>::quiet_NaN();
  MPI_Allreduce(MPI_IN_PLACE, &part, 1, MPI_DOUBLE, norm == Norm::max ? MPI_MAX : MPI_SUM, comm);
  return norm == Norm::l2 ? std::sqrt(part) : part;
}

}  // namespace amrpic
