#pragma once

#include <array>

#include "external/external_fields.hpp"
#include "mesh/electric_field.hpp"
#include "particle/clouds.hpp"
#include "particle/motion.hpp"
#include "particle/remote_bricks.hpp"
#include "particle/view.hpp"

namespace amrpic {

class ParticleMesh;

/// Fields at each particle that are added to those of the mesh; null where there are none.
struct AddedFields {
  std::array<Real*, 3> electric{};  ///< V/m
  std::array<Real*, 3> magnetic{};  ///< T
};

/// How particles move by fields.
struct Motion {
  Real const* charge;        ///< of a real particle, C
  Real const* inverse_mass;  ///< 1/kg
  bool same;                 ///< one value of either for all, else one for each
  Real before, after;        ///< s, in the fields: the two parts act on the momentum one after the other
  Real flight;               ///< s
  Pusher pusher;
  Real3 beta;  ///< velocity over c of the charge whose field the mesh holds: B = beta x E / c
  AddedFields added;
  ExternalFields const* external = nullptr;  ///< of elements; null where there are none
  Real time = 0;                             ///< s, of the positions
  Real3 shift{};                             ///< m, of the mesh's origin during the flight: new places are less by it
};

/// Where particles are written: positions in m, momenta in kg m/s.
struct Moved {
  std::array<Real*, 3> momentum, position;
  std::array<Real*, 3> between{};  ///< momenta after `before` seconds; null if they are not wanted
};

/// Write momenta after `before` and `after` seconds in the fields at their places, and the positions that a flight with
/// these leads to: what `gather` would give is used and not kept. Each part is half of a kick by E, a turn by B and the
/// other half, so that momenta between the parts are those of that time however large E and v x B are that cancel; the
/// fields of elements are the means over the straight flight of each part, see `add_mean_field`. Otherwise as `gather`.
/// Collective.
void push(ParticleMesh& mesh, RemoteBricks const& remote, Clouds const& clouds, ElectricField const& field,
          ParticleView const& particles, std::int64_t const* starts, Motion const& motion, Moved const& out);

/// A particle by itself.
struct OneParticle {
  Real3 position, momentum;  ///< m, kg m/s
  Real charge, inverse_mass;
};

/// The same for one particle, without a field of the mesh, added fields and a shift. Local.
OneParticle push_one(OneParticle const& particle, Motion const& motion);

}  // namespace amrpic
