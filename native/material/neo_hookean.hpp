#pragma once

#include <cmath>

#include "material/tangent.hpp"

namespace amrpic::material {

/// energy = mu/2 (I1 - 3) - mu ln J + lambda/2 ln² J, per initial volume, with I1 the trace of F'F and J = det F > 0.
struct NeoHookean {
  Real mu, lambda;

  Real energy(Tensor const& f) const {
    Real const log_j = std::log(determinant(f));
    return mu / 2 * (contraction(f, f) - 3) - mu * log_j + lambda / 2 * log_j * log_j;
  }
  /// Kirchhoff's stress: J times Cauchy's.
  Tensor stress(Tensor const& f) const {
    Tensor const b = product(f, transposed(f));
    return sum(unit_tensor(lambda * std::log(determinant(f)) - mu), mu, b);
  }
  IsotropicModuli moduli(Tensor const& f) const { return {lambda, 2 * (mu - lambda * std::log(determinant(f)))}; }
  /// How the first stress of Piola and Kirchhoff changes with F, in the initial configuration.
  Tensor change_initially(Tensor const& f, Tensor const& change) const {
    Tensor const inverse_f = inverse(f), relative = product(inverse_f, change);
    Real const log_j = std::log(determinant(f));
    Tensor const back = transposed(product(relative, inverse_f));
    return sum(sum(scaled(mu, change), mu - lambda * log_j, back), lambda * trace(relative), transposed(inverse_f));
  }
};

}  // namespace amrpic::material
