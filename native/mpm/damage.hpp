#pragma once

#include <memory>
#include <vector>

#include "fem/operators.hpp"

namespace amrpic::mpm {

/// What damage is found from: 2 (1 - k) H (1 - d) = G/l (d - l² Laplacian d), in weak form over initial volumes with
/// gradients in the mesh's configuration. Points whose toughness is zero have no part in it.
struct DamageEquation {
  std::shared_ptr<fem::Points const> points;
  std::vector<Real> volume;   ///< initial ones, m³
  std::vector<Real> driving;  ///< 2 (1 - k) H, J/m³
  std::vector<Real> surface;  ///< G/l, J/m³
  std::vector<Real> length;   ///< l, m
};
std::unique_ptr<fem::Operator> damage_operator(DamageEquation const& equation);

}  // namespace amrpic::mpm
