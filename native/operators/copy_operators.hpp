#pragma once

#include "base/communicator.hpp"
#include "operators/semicoarse.hpp"

namespace amrpic {

/// The operators of a copy as compressed rows.
struct CopyOperators {
  LevelOperators level;  ///< `no_fine` and the halos alone are made
  Crs restriction;       ///< columns: the level above, whose remote cells `above` brings
  Crs prolongation;      ///< rows: of the level above; columns: the copy, whose remote cells `own` brings
  Halo above, own;
};

/// The operators of a copy of a level, which is that above it; `shift`: of the Equation. Collective.
CopyOperators copy_operators(Communicator const& comm, Level const& above, LevelCopy const& copy, Real shift);

}  // namespace amrpic
