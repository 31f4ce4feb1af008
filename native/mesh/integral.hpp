#pragma once

#include "mesh/electric_field.hpp"
#include "mesh/field.hpp"

namespace amrpic {

/// Volume integral of a field over the cells that no finer level covers. Collective.
Real integral(Field const& field);

/// The same of the product of two fields on one hierarchy. Collective.
Real integral(Field const& one, Field const& other);

/// The same of the square of a vector field. Collective.
Real integral_of_square(ElectricField const& field);

}  // namespace amrpic
