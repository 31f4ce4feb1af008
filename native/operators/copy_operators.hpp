#pragma once

#include "base/communicator.hpp"
#include "operators/operators.hpp"
#include "operators/semicoarse.hpp"

namespace amrpic {

/// The operators of a copy as compressed rows.
struct CopyOperators {
  std::shared_ptr<LevelOperators> level;    ///< `no_fine` alone is made
  std::shared_ptr<LevelCells const> above;  ///< what restriction reads of the level above
  SparseMatrix restriction;                 ///< columns: `above`
  SparseMatrix prolongation;                ///< rows: of the level above; columns: the copy's
};

/// The operators of a copy of the level of `above`, which is that above it; `shift`: of the Equation. Collective.
CopyOperators copy_operators(Communicator const& comm, std::shared_ptr<Level const> const& above, LevelCopy const& copy,
                             Real shift);

}  // namespace amrpic
