#pragma once

#include "particle/view.hpp"

namespace amrpic {

/// Write positions after a flight into `out`: x + p times `time_over_mass` (s/kg), one for all particles or one for
/// each.
void drift(ParticleView const& particles, Real const* time_over_mass, bool same, std::array<Real*, 3> const& out);

}  // namespace amrpic
