#pragma once

#include <cmath>

#include "material/tangent.hpp"

namespace amrpic::material {

/// A neo-Hookean solid with damage d by a phase field (AT2): energy = g(d) driving + rest, g = (1 - k)(1 - d)² + k. The
/// part that drives damage is that of changes of shape, and of volume where J >= 1.
struct DamagedNeoHookean {
  Real mu, lambda;
  Real residual;  ///< k

  Real bulk() const { return lambda + 2 * mu / 3; }
  Real degradation(Real damage) const { return (1 - residual) * (1 - damage) * (1 - damage) + residual; }

  Real of_shape(Tensor const& f) const { return mu / 2 * (contraction(f, f) / cbrt_squared(determinant(f)) - 3); }
  Real of_volume(Tensor const& f) const {
    Real const j = determinant(f);
    return bulk() / 4 * (j * j - 1 - 2 * std::log(j));
  }
  Real driving_energy(Tensor const& f) const { return of_shape(f) + (determinant(f) >= 1 ? of_volume(f) : 0); }
  Real energy(Tensor const& f, Real damage) const {
    return degradation(damage) * driving_energy(f) + (determinant(f) >= 1 ? 0 : of_volume(f));
  }

  Tensor stress(Tensor const& f, Real damage) const {
    Real const j = determinant(f), g = degradation(damage);
    return sum(unit_tensor(of_volume_by(g, j) * bulk() / 2 * (j * j - 1)), g, deviator(f));
  }
  IsotropicModuli moduli(Tensor const& f, Real damage) const {
    Real const j = determinant(f), g = degradation(damage), volume = of_volume_by(g, j) * bulk();
    Real const shape = 2 * mu * contraction(f, f) / cbrt_squared(j) / 3;
    return {volume * j * j - g * shape / 3, g * shape - volume * (j * j - 1), 2 * g / 3, deviator(f)};
  }

  /// Damage of one point by itself that has seen a driving energy: toughness G in J/m², length of the crack's profile.
  Real damage_of(Real driving, Real toughness, Real length) const {
    Real const by = 2 * (1 - residual) * driving;
    return by / (by + toughness / length);
  }

 private:
  static Real cbrt_squared(Real j) { return std::cbrt(j) * std::cbrt(j); }
  Real of_volume_by(Real g, Real j) const { return j >= 1 ? g : 1; }
  /// Kirchhoff's stress of changes of shape, undamaged.
  Tensor deviator(Tensor const& f) const {
    Tensor const b = product(f, transposed(f));
    Real const by = mu / cbrt_squared(determinant(f));
    return sum(scaled(by, b), -by * trace(b) / 3, unit_tensor());
  }
};

}  // namespace amrpic::material
