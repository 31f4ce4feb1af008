#pragma once

#include <array>

#include "mesh/field.hpp"
#include "particle/clouds.hpp"
#include "particle/particle_mesh.hpp"
#include "particle/view.hpp"

namespace amrpic {

/// Write the vector field `field` (its components along x, y, z) at the particles into `at_particles`, with the shares
/// that `deposit` gives their charge. Collective.
///
/// Particles are sorted by slot: those of slot s are starts[s] to starts[s + 1]. Clouds that overhang refined cells
/// take what the field holds in the covered ones. Cells beyond the edge of a level are interpolated trilinearly from
/// the coarser level; beyond a wall stands the wall cell. Throws std::out_of_range, on all ranks, if a particle lies
/// outside the box it is sorted into.
void gather(ParticleMesh& mesh, Clouds const& clouds, std::array<Field const*, 3> const& field,
            ParticleView const& particles, std::int64_t const* starts, std::array<Real*, 3> const& at_particles);

/// How a field changes momenta.
struct Kick {
  Real const* charge;  ///< of a real particle, C: one for all, or one for each
  bool same_charge;
  Real before, after;  ///< s
};

/// Write momenta after a kick of `before` seconds by the field at the particles into `now`, and those after a further
/// one of `after` seconds in the same field into `onward`: what `gather` would give is used and not kept. Otherwise
/// as `gather`. Collective.
void accelerate(ParticleMesh& mesh, Clouds const& clouds, std::array<Field const*, 3> const& field,
                ParticleView const& particles, std::int64_t const* starts, Kick const& kick,
                std::array<Real*, 3> const& now, std::array<Real*, 3> const& onward);

}  // namespace amrpic
