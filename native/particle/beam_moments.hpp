#pragma once

#include "base/communicator.hpp"
#include "particle/beam_parts.hpp"

namespace amrpic {

/// Coordinates of a particle: position (m), momentum over m c, kinetic energy (J). Position d and momentum d + 3 make a
/// plane.
constexpr std::size_t beam_coordinates = 7;

/// Moments of a part of a beam: weighted sums of products of the deviations from a centre, to second order among all
/// coordinates and to fourth order in each plane.
///
/// Parts are joined by moving both to their common mean, where nothing large cancels (P. Pebay et al., "Numerically
/// stable, scalable formulas for parallel and online computation of higher-order multivariate central moments with
/// arbitrary weights", Computational Statistics 31 (2016) 1305).
struct BeamMoments {
  typedef std::array<Real, beam_coordinates> Coordinates;
  typedef std::array<std::array<Real, 5>, 5> Plane;  ///< [a][b]: of q^a p^b, a + b <= 4

  Real count = 0;   ///< macroparticles
  Real weight = 0;  ///< real particles
  Coordinates centre{};
  Coordinates first{};
  std::array<Coordinates, beam_coordinates> second{};
  std::array<Plane, 3> planes{};
  Coordinates lowest, highest;

  BeamMoments();

  /// Refer the sums to another centre, `shift` before the present one.
  void move_by(Coordinates const& shift);
  /// Refer the sums to the mean.
  void move_to_mean();
  /// Take in another part of the beam.
  void add(BeamMoments const& other);
};

/// Those of the parts of a beam on all ranks, about their means. Collective.
std::vector<BeamMoments> beam_moments(Communicator const& comm, BeamView const& beam, BeamParts const& parts);

/// Those of several parts together, about their mean.
BeamMoments joined_moments(std::vector<BeamMoments> const& parts);

}  // namespace amrpic
