#pragma once

#include "base/communicator.hpp"
#include "matrices/operators.hpp"
#include "multigrid/semicoarse.hpp"

namespace amrpic {

/// The operators of a semicoarsened level as compressed rows.
struct SemicoarseOperators {
  std::shared_ptr<LevelOperators> level;    ///< `no_fine` and `restriction` alone are made
  std::shared_ptr<LevelCells const> finer;  ///< what restriction reads of the finer level
  SparseMatrix prolongation;                ///< rows: of the finer level
};

/// `shift`: of the Equation; `metal`: on the level, and on the finer one, in this rank's boxes. Collective.
SemicoarseOperators semicoarse_operators(Communicator const& comm, std::shared_ptr<Level const> const& finer,
                                         SemicoarsenedLevel const& level, Real shift,
                                         std::array<MetalCells, 2> const& metal = {});

}  // namespace amrpic
