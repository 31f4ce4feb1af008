#pragma once

#include <vector>

#include "mesh/field.hpp"

namespace amrpic {

/// Values of a field at points (metres), the same on all ranks: trilinear between the cells of the finest level at the
/// point; a neighbour that this level lacks takes the coarser level's value there, one behind a wall that of the wall
/// cell. Points beyond a periodic face have the value of their image in the domain, others outside it nan. All ranks
/// pass the same points. Collective.
std::vector<Real> sample(Field const& field, std::vector<Real3> const& points);

}  // namespace amrpic
