#pragma once

#include <vector>

#include "material/tangent.hpp"

namespace amrpic::material {

/// energy = sum of mu/alpha (sum of stretches^alpha - 3) - sum of mu ln J + lambda/2 ln² J, with principal stretches.
struct Ogden {
  struct Term {
    Real mu, alpha;
  };
  std::vector<Term> terms;
  Real lambda;

  Real energy(Tensor const& f) const;
  Tensor stress(Tensor const& f) const;
  PrincipalModuli moduli(Tensor const& f) const;
  /// How the first stress of Piola and Kirchhoff changes with F, by directions of the initial configuration.
  Tensor change_initially(Tensor const& f, Tensor const& change) const;
};

}  // namespace amrpic::material
