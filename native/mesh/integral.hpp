#pragma once

#include "mesh/field.hpp"

namespace amrpic {

/// Volume integral of a field over the cells that no finer level covers. Collective.
Real integral(Field const& field);

/// The same of the product of two fields on one hierarchy. Collective.
Real integral(Field const& a, Field const& b);

}  // namespace amrpic
