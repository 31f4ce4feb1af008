#pragma once

#include "mesh/field.hpp"
#include "particle/clouds.hpp"
#include "particle/particle_mesh.hpp"
#include "particle/remote_bricks.hpp"
#include "particle/view.hpp"

namespace amrpic {

/// Set `density` to the charge density of the particles in C/m³; covered cells hold the mean of their children.
/// Collective.
///
/// `charge` is that of one real particle. Particles are sorted by slot, boxes of this rank and then remote bricks:
/// those of slot s are starts[s] to starts[s + 1]. Where a cloud leaves its level, the coarser cell there takes that
/// part; the part of a covered cell is distributed equally to its children; what overhangs a wall is folded onto the
/// wall cell. So the total charge is kept to rounding. Throws std::out_of_range, on all ranks, if a particle lies
/// outside the box it is sorted into.
void deposit(ParticleMesh& mesh, RemoteBricks const& remote, Clouds const& clouds, ParticleView const& particles,
             std::int64_t const* starts, Real charge, Field& density);

}  // namespace amrpic
