#pragma once

#include <vector>

#include "mesh/electric_field.hpp"
#include "mesh/field.hpp"

namespace amrpic {

/// Volume integral of a field over those of this rank's cells that no finer level covers. Local.
Real integral(Field const& field);

/// The same of the product of two fields on one hierarchy. Local.
Real integral(Field const& one, Field const& other);

/// The same of one (other + weight one), with the weight of each level. Local.
Real integral(Field const& one, Field const& other, std::vector<Real> const& weight);

/// The same of the square of a vector field. Local.
Real integral_of_square(ElectricField const& field);

}  // namespace amrpic
