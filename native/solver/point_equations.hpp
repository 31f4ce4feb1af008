#pragma once

#include <vector>

#include "base/communicator.hpp"
#include "base/types.hpp"

namespace amrpic {

/// This rank's rows of a sparse matrix that is not symmetric, by compressed rows; ranks have runs of rows, rank by
/// rank.
struct SharedRows {
  std::vector<std::size_t> row_start{0};
  std::vector<GlobalIndex> column;  ///< among the rows of all ranks, once each in a row
  std::vector<Real> value;

  LocalIndex rows() const { return LocalIndex(row_start.size()) - 1; }
};

struct PointSolution {
  std::vector<Real> x;  ///< this rank's rows, one right-hand side after the other
  int iterations;       ///< of the worst right-hand side
  Real residual;        ///< |b - A x| / |b|, of the worst one too
};

/// Solve A x = b for right-hand sides one after the other: GMRES of Belos, with MueLu's plain aggregates on the right.
///
/// Rows should be of the same size, for instance with ones on the diagonal. Aggregates are not smoothed: rows of least
/// squares have entries of either sign, which spoil smoothed ones. The coarsest level is relaxed, for Amesos2's KLU2
/// gives wrong answers on several ranks. What it reached is returned, converged or not. Collective.
PointSolution solve_points(Communicator const& comm, SharedRows const& rows, std::vector<Real> const& right_hand_sides,
                           std::size_t vectors, Real tolerance, int most_iterations);

}  // namespace amrpic
