#pragma once

#include <memory>
#include <vector>

#include "base/communicator.hpp"
#include "matrices/operators.hpp"
#include "solver/options.hpp"

namespace amrpic {

/// What holds the mean of a correction on the coarsest level.
enum class Mean {
  equation,  ///< the equation, as all else
  others,    ///< it is found apart from cycles, and stays zero here
  nothing    ///< so it does, and constants are in the null space, or as good as
};

/// The solve on the coarsest level, by a method of Trilinos.
///
/// Every rank gathers the whole problem, cells in the order of the domain, and solves it by itself: so the answer is
/// the same for any decomposition, and no solver of the library runs on shared rows.
class Bottom {
 public:
  /// Collective. Throws SolverError, the same on all ranks, for a matrix that the method cannot solve.
  Bottom(Communicator const& comm, LevelOperators const& operators, Mean mean, SolverOptions const& options);
  ~Bottom();

  /// Solve no_fine correction = right_hand_side for this rank's cells. Collective.
  void solve(LevelVector const& right_hand_side, LevelVector& correction);

  /// Whether this is what would be set up for another level, which has the same cells: one whose matrix, owners
  /// included, is equal. Collective.
  bool serves(LevelOperators const& operators) const;

 private:
  struct GatheredProblem;
  struct OnDevice {
    DeviceArray<LocalIndex> place;
    DeviceArray<Real> volume, gathered;
  };
  void gather_right_hand_side(LevelVector const& right_hand_side) const;
  Communicator comm_;
  Mean mean_;
  GlobalIndex first_, total_;
  std::vector<int> counts_, starts_;  ///< rows per rank
  std::vector<LocalIndex> place_;     ///< in the order of the domain, of each cell
  /// The same; the volume of each cell in the order of the domain, over that of ordinary ones; and room for a gathered
  /// right-hand side.
  UntilFinalize<OnDevice> on_device_;
  std::unique_ptr<GatheredProblem> problem_;
};

}  // namespace amrpic
