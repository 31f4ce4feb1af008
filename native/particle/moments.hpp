#pragma once

#include "base/communicator.hpp"
#include "particle/beam_parts.hpp"

namespace amrpic {

/// What the moments of a beam are made of, each particle counted as the real ones that it stands for; `T` is one
/// number, or eight for as many parts of the beam.
template <class T>
struct BeamSums {
  typedef std::array<T, 3> Vector;

  T weight{};               ///< real particles
  T kinetic_energy{};       ///< J
  Vector momentum{};        ///< kg m/s
  Vector mean_x{};          ///< position, m
  Vector mean_u{};          ///< momentum over m c
  Vector xx{}, uu{}, xu{};  ///< sums of the products of deviations from those means

  /// Take in particles that lie in one point, as far as means and deviations go.
  ///
  /// Deviations are from the means so far: differences of large squares would lose the size of a bunch far off, or that
  /// of a core with a far halo (Chan, Golub and LeVeque, American Statistician 37 (1983) 242, eq. 1.5).
  void add(T const& more, Vector const& x, Vector const& u) {
    T const total = weight + more;
    T const share = select(total > T{}, more / total, T{}), pull = weight * share;
    for (std::size_t d = 0; d < 3; ++d) {
      T const dx = x[d] - mean_x[d], du = u[d] - mean_u[d];
      xx[d] += pull * dx * dx;
      uu[d] += pull * du * du;
      xu[d] += pull * dx * du;
      mean_x[d] += share * dx;
      mean_u[d] += share * du;
    }
    weight = total;
  }

  /// Take in another part of the beam.
  void add(BeamSums const& other) {
    add(other.weight, other.mean_x, other.mean_u);
    kinetic_energy += other.kinetic_energy;
    for (std::size_t d = 0; d < 3; ++d) {
      momentum[d] += other.momentum[d];
      xx[d] += other.xx[d];
      uu[d] += other.uu[d];
      xu[d] += other.xu[d];
    }
  }
};

/// Those of the particles of all ranks, for whose places their nearest images stand. Collective.
BeamSums<Real> beam_sums(Communicator const& comm, BeamView const& beam, NearestImages const& images);

/// For each group of particles on all ranks the sum of their weights, that of the squares, and along x, y and z those
/// of weight times cosine and sine of 2π (x - lower) / period, zeros where a period is 0. Collective.
///
/// Both are within 1.1e-3 of these functions and of period 1 as they are: good for the middle of a beam.
std::vector<std::array<Real, 8>> circular_sums(Communicator const& comm, BeamView const& beam, BeamParts const& parts,
                                               Real3 const& lower, Real3 const& period);

}  // namespace amrpic
