#pragma once

#include "matrices/tpetra.hpp"
#include "solver/point_equations.hpp"

namespace amrpic {

/// Tpetra's form of rows that are shared out over ranks as `own` says. Collective.
Teuchos::RCP<TpetraTypes::Matrix> tpetra_matrix(SharedRows const& rows,
                                                Teuchos::RCP<TpetraTypes::Map const> const& own);

}  // namespace amrpic
