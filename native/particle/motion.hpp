// How momenta and places change in fields, relativistically: formulas of values, of one particle or of eight at a time.
#pragma once

#include "base/constants.hpp"
#include "base/inverse_root.hpp"
#include "base/lanes.hpp"
#include "base/vector3.hpp"

namespace amrpic {

/// One over the Lorentz factor of a momentum (kg m/s), with one over m c.
template <class V>
inline V inverse_gamma(Vector3<V> const& p, V const& per_mc) {
  Vector3<V> const u{p[0] * per_mc, p[1] * per_mc, p[2] * per_mc};
  return 1 / square_root(1 + dot(u, u));
}

enum class Pusher {
  boris,         ///< J. P. Boris (1970): the angle follows from gamma after half the electric kick
  higuera_cary,  ///< A. V. Higuera and J. R. Cary, Phys. Plasmas 24, 052104 (2017): keeps E + v x B = 0 at rest
};

/// The momentum after `time` in a magnetic field, half a step of the pusher: two such steps in a row turn by its whole
/// angle, and what is between them has the same magnitude.
///
/// Both pushers turn p by 2 atan t about B with t = tau / g, tau = q B time / m. Boris has g = gamma. Higuera and Cary
/// have g^2 = (s + sqrt(s^2 + 4 (tau^2 + (tau . u)^2))) / 2 with s = gamma^2 - tau^2, u = p / (m c) (their eq. 20).
/// Neither g changes by the turn, so that its second half finds the same one.
template <class V>
inline Vector3<V> turned(Pusher pusher, Vector3<V> const& p, Vector3<V> const& b, V const& charge_over_mass_time,
                         V const& per_mc) {
  Vector3<V> tau, u;
  for (std::size_t d = 0; d < 3; ++d) tau[d] = charge_over_mass_time * b[d], u[d] = p[d] * per_mc;
  V const tau_square = dot(tau, tau);
  V g_square = 1 + dot(u, u);
  if (pusher == Pusher::higuera_cary) {
    V const along = dot(tau, u), s = g_square - tau_square, under = s * s + 4 * (tau_square + along * along);
    g_square = 0.5 * (s + under * inverse_root(under));
  }
  // By tan of half the angle atan t, which is t / (1 + sqrt(1 + t^2)) = tau / (g + w) with w^2 = g^2 + tau^2.
  V const per_w = inverse_root(g_square + tau_square), sum_over_w = 1 + g_square * inverse_root(g_square) * per_w;
  V const scale = per_w / sum_over_w;
  Vector3<V> half;
  for (std::size_t d = 0; d < 3; ++d) half[d] = scale * tau[d];
  Vector3<V> out = cross(p, half);
  for (std::size_t d = 0; d < 3; ++d) out[d] += p[d];
  out = cross(out, half);
  for (std::size_t d = 0; d < 3; ++d) out[d] = p[d] + sum_over_w * out[d];
  return out;
}

}  // namespace amrpic
