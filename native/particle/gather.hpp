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

}  // namespace amrpic
