#pragma once

#include "particle/sort.hpp"

namespace amrpic {

/// Copy the particles that stay on this rank to their places in `out`, whose weights are not written if they are equal.
/// False if one of their momenta is not finite. Local.
bool copy(ParticleMesh const& mesh, ParticleView const& particles, Destinations const& destinations,
          Places const& places, ParticleView const& out);

/// The same of further columns of eight bytes, from and to, and of those that arrived: `arrived` are their values,
/// particle after particle. Bytes are copied, whatever they mean. Local.
void copy_columns(std::vector<Real const*> const& from, std::vector<Real*> const& to, std::int64_t count,
                  Destinations const& destinations, Places const& places, std::vector<Portion> const& arrivals,
                  std::vector<Real> const& arrived);

}  // namespace amrpic
