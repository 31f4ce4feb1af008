#pragma once

#include "particle/sort.hpp"

namespace amrpic {

/// Copy the particles that stay on this rank, and those that arrived, to their places in `out`, whose weights are not
/// written if they are equal. False if a momentum of those that stay is not finite. Local.
bool copy(ParticleMesh const& mesh, ParticleView const& particles, Destinations const& destinations,
          PackedParticles const& arrivals, Places const& places, ParticleView const& out);

/// The same of further columns of eight bytes, from and to; `arrived` are the values of those that arrived,
/// particle after particle. Bytes are copied, whatever they mean. Local.
void copy_columns(std::vector<Real const*> const& from, std::vector<Real*> const& to, std::int64_t count,
                  Destinations const& destinations, Places const& places, std::vector<Real> const& arrived);

}  // namespace amrpic
