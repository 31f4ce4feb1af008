#pragma once

#include "mesh/field.hpp"

namespace amrpic {

/// Set `to` to the values of `from`, which lives on another hierarchy of the same domain. Collective.
///
/// A cell of a level that `from` has too is copied, wherever its owners are. A newly refined cell is interpolated from
/// the next coarser level of `to`: per axis a parabola through the means of three parents, whose mean over either half
/// of the middle one is taken. That is of third order, exact for linear fields also at walls, and keeps the mean of the
/// parent, so that refining and coarsening again changes nothing. Cells that are no longer covered keep what they hold,
/// which in every field of the package is the mean of their former children.
void carry_over(Field const& from, Field& to);

}  // namespace amrpic
