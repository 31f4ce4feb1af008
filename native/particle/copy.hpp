#pragma once

#include "particle/sort.hpp"

namespace amrpic {

/// Copy the particles that stay on this rank, and those that arrived, to their places in `out`, whose weights are not
/// written if they are equal. False if a momentum of those that stay is not finite. Local.
bool copy(ParticleMesh const& mesh, ParticleView const& particles, Destinations const& destinations,
          PackedParticles const& arrivals, Places const& places, ParticleView const& out);

}  // namespace amrpic
