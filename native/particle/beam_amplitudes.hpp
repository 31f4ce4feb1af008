#pragma once

#include "base/communicator.hpp"
#include "particle/beam_parts.hpp"

namespace amrpic {

/// Amplitudes of a particle about the centre of its part: a quadratic form in each plane, the distance from the axis
/// along z, and the distance from the centre, both in m.
constexpr std::size_t amplitude_kinds = 5;

/// What amplitudes in a part of a beam refer to.
struct AmplitudeFrame {
  std::array<Real, 6> centre;                 ///< positions (m), momenta over m c
  std::array<Real3, 3> forms;                 ///< a, b, c per plane: of the form a q² + b q p + c p²
  std::array<Real, amplitude_kinds> typical;  ///< values: of the forms, and of the squares of distances; nan: not asked
};

/// The amplitudes that hold these fractions, up to 32, of the real particles of each part, on all ranks:
/// [part][kind][fraction], the parts of all `layers` one after the other: a particle may belong to one of each. Each is
/// the least of a particle of the part such that particles up to it make up the fraction, to 1e-12 of the weight, and
/// nan for a part without weight. Collective.
///
/// Sums of weight over bins of the values, which get narrower until they hold one number, take the place of sorting.
std::vector<Real> amplitude_quantiles(Communicator const& comm, BeamView const& beam,
                                      std::vector<BeamParts> const& layers, std::vector<AmplitudeFrame> const& frames,
                                      std::vector<Real> const& fractions);

}  // namespace amrpic
