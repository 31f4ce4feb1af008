// How momenta and places change in fields, relativistically: formulas of values, of one particle or of eight at a time.
#pragma once

#include "base/inverse_root.hpp"
#include "base/vector3.hpp"

namespace amrpic {

/// The square of the Lorentz factor of a momentum (kg m/s), with one over m c.
template <class V>
KOKKOS_INLINE_FUNCTION V gamma_square(Vector3<V> const& p, V const& per_mc) {
  return 1 + per_mc * per_mc * dot(p, p);
}

/// One over the Lorentz factor.
template <class V>
KOKKOS_INLINE_FUNCTION V inverse_gamma(Vector3<V> const& p, V const& per_mc) {
  return inverse_root(gamma_square(p, per_mc));
}

enum class Pusher {
  boris,         ///< J. P. Boris (1970): the angle follows from gamma after half the electric kick
  higuera_cary,  ///< A. V. Higuera and J. R. Cary, Phys. Plasmas 24, 052104 (2017): keeps E + v x B = 0 at rest
};

/// A momentum after its turn about a magnetic field, with charge / mass * half of the time.
///
/// Both pushers turn p by 2 atan t about B with t = tau / g, tau = q B time / (2 m). Boris has g = gamma. Higuera and
/// Cary have g^2 = (s + sqrt(s^2 + 4 (tau^2 + (tau . u)^2))) / 2 with s = gamma^2 - tau^2, u = p / (m c) (their eq.
/// 20). With w^2 = g^2 + tau^2 and f = g p + p x tau the turn is p + 2 f x tau / w^2.
template <class V>
KOKKOS_INLINE_FUNCTION Vector3<V> turned(Pusher pusher, Vector3<V> const& p, Vector3<V> const& b,
                                         V const& charge_over_mass_half, V const& per_mc) {
  Vector3<V> const tau = scaled(charge_over_mass_half, b);
  V const tau_square = dot(tau, tau);
  V g_square = gamma_square(p, per_mc);
  if (pusher == Pusher::higuera_cary) {
    V const half_s = 0.5 * (g_square - tau_square), along_u = per_mc * dot(tau, p);
    g_square = half_s + square_root(half_s * half_s + (tau_square + along_u * along_u));
  }
  V const g = square_root(g_square), twice = 2 * reciprocal(g_square + tau_square);
  Vector3<V> f = cross(p, tau);
  for (std::size_t d = 0; d < 3; ++d) f[d] += g * p[d];
  Vector3<V> out = cross(f, tau);
  for (std::size_t d = 0; d < 3; ++d) out[d] = p[d] + twice * out[d];
  return out;
}

}  // namespace amrpic
