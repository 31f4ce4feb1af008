#pragma once

#include <array>

#include "mesh/electric_field.hpp"
#include "particle/clouds.hpp"
#include "particle/particle_mesh.hpp"
#include "particle/view.hpp"

namespace amrpic {

/// Write the components of a field at the particles into `at_particles`, with the weights that `deposit` gives their
/// charge. Collective.
///
/// Particles are sorted by slot: those of slot s are starts[s] to starts[s + 1]. Clouds that overhang refined cells
/// take what the field holds in the covered ones. Ghost cells outside a level are interpolated trilinearly from
/// the coarser level; behind a wall stands the wall cell. Throws std::out_of_range, on all ranks, if a particle lies
/// outside the box it is sorted into.
void gather(ParticleMesh& mesh, Clouds const& clouds, ElectricField const& field, ParticleView const& particles,
            std::int64_t const* starts, std::array<Real*, 3> const& at_particles);

/// How particles move by a field.
struct Motion {
  Real const* charge;          ///< of a real particle, C
  Real const* time_over_mass;  ///< of the flight, s/kg
  bool same;                   ///< one value of either for all, else one for each
  Real before, after;          ///< s, in the field: its two parts add to the momentum one after the other
};

/// Where particles are written: positions in m, momenta in kg m/s.
struct Moved {
  std::array<Real*, 3> momentum, position;
};

/// Write momenta after `before` and `after` seconds in the field, and the positions that a flight with these leads to:
/// what `gather` would give is used and not kept. Otherwise as `gather`. Collective.
void push(ParticleMesh& mesh, Clouds const& clouds, ElectricField const& field, ParticleView const& particles,
          std::int64_t const* starts, Motion const& motion, Moved const& out);

}  // namespace amrpic
