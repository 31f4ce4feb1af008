#pragma once

#include <array>

#include "mesh/electric_field.hpp"
#include "particle/callers_columns.hpp"
#include "particle/clouds.hpp"
#include "particle/particle_mesh.hpp"
#include "particle/remote_bricks.hpp"
#include "particle/view.hpp"

namespace amrpic {

/// Write the components of a field at the particles into `at_particles`, with the weights that `deposit` gives their
/// charge. Collective.
///
/// Particles are sorted by slot, boxes of this rank and then remote bricks: those of slot s are starts[s] to
/// starts[s + 1]. Clouds that overhang refined cells
/// take what the field holds in the covered ones. Ghost cells outside a level are interpolated trilinearly from
/// the coarser level; behind a wall stands the wall cell. Throws std::out_of_range, on all ranks, if a particle lies
/// outside the box it is sorted into.
void gather(ParticleMesh& mesh, RemoteBricks const& remote, Clouds const& clouds, ElectricField const& field,
            ParticleView const& particles, std::int64_t const* starts, std::array<Real*, 3> const& at_particles);

/// Write what `gather` finds to the places that a caller has for the particles. Collective.
void gather_into_places(ParticleMesh& mesh, RemoteBricks const& remote, Clouds const& clouds,
                        ElectricField const& field, ParticleView const& particles, std::int64_t const* starts,
                        CallersPlaces const& to, std::array<Real*, 3> const& out);

}  // namespace amrpic
