#pragma once

#include <mpi.h>

#include <memory>
#include <vector>

#include "operators/operators.hpp"

namespace amrpic {

/// The solve on the coarsest level: GMRES by Belos, preconditioned by MueLu.
///
/// Every rank gathers the whole (small) problem and solves it by itself, so the answer is the same on any number of
/// ranks and no solver of the library runs on shared rows.
class Bottom {
 public:
  /// Collective. `singular`: constants are in the operator's null space.
  Bottom(MPI_Comm comm, LevelOperators const& operators, bool singular);
  ~Bottom();

  /// Solve no_fine correction = right_hand_side for this rank's cells. Collective.
  void solve(std::vector<Real> const& right_hand_side, std::vector<Real>& correction);

 private:
  struct Problem;
  MPI_Comm comm_;
  bool singular_;
  LocalIndex rows_;  ///< of this rank
  GlobalIndex first_, total_;
  std::vector<int> counts_, starts_;  ///< rows per rank
  std::vector<Real> whole_right_hand_side_, whole_correction_;
  std::unique_ptr<Problem> problem_;
};

}  // namespace amrpic
