#pragma once

#include <functional>
#include <memory>
#include <vector>

#include "mesh/field.hpp"
#include "particle/clouds.hpp"
#include "particle/migrate.hpp"
#include "particle/particle_mesh.hpp"
#include "particle/remote_bricks.hpp"
#include "particle/view.hpp"

namespace amrpic {

/// Sets `density` to the charge density of particles in C/m³; covered cells hold the mean of their children.
///
/// `charge` is that of one real particle. Particles are sorted by slot, boxes of this rank and then remote bricks:
/// those of slot s are starts[s] to starts[s + 1]. Where a cloud leaves its level, the coarser cell there takes that
/// part; the part of a covered cell is distributed equally to its children; what overhangs a wall is folded onto the
/// wall cell. So the total charge is kept to rounding. What is given must live until `finish`.
class Deposition {
 public:
  Deposition(ParticleMesh& mesh, RemoteBricks const& remote, Clouds const& clouds, ParticleView const& particles,
             std::int64_t const* starts, Real charge, Field& density);
  ~Deposition();

  /// Deposit particles while others are `under_way`, of which the positions alone are read and lie in their bricks.
  /// Boxes with too few particles wait for `finish`, and all do for portable kernels. `poll` is called at times. Local.
  void begin(std::vector<PlaceRange> const& under_way, std::function<void()> const& poll);
  /// Deposit all others. Throws std::out_of_range, on all ranks, if a particle lies outside the box it is sorted into.
  /// Collective.
  void finish();
  std::int64_t left() const;  ///< how many particles of this rank these are

 private:
  class Sums;
  std::unique_ptr<Sums> sums_;
};

}  // namespace amrpic
