// Deposit, gather and push where loops over particles are executed elsewhere, many boxes at a time. Without vectors,
// which the compilers of devices do not know.
#pragma once

#include <vector>

#include "particle/box_frame.hpp"
#include "particle/buffer_zone.hpp"
#include "particle/mover.hpp"

namespace amrpic {

/// Particles of a box, and the tiles that their clouds touch.
struct OnTiles {
  /// What kernels need of a `Tile`.
  struct Numbers {
    BoxFrame frame;
    Real* values;
    std::ptrdiff_t count, corner, stride_y, stride_z;
  };
  std::int64_t first, last;
  BoxBuffer const* buffer;        ///< null if all clouds lie in the first tile
  std::vector<Numbers> by_depth;  ///< of coarsening
};

/// The loops over particles. Each returns the first particle that lies outside its box, -1 if none does.
class TileKernels {
 public:
  virtual ~TileKernels() = default;
  /// How many cells' tiles make it worth while to run.
  virtual std::int64_t cells_at_once() const = 0;
  /// Add the clouds of particles, in real particles per cell, to tiles that are zero before.
  virtual std::int64_t deposit(Shape shape, ParticleView const& particles, std::vector<OnTiles> const& on) const = 0;
  /// Average the tiles over the clouds.
  virtual std::int64_t gather(Shape shape, ParticleView const& particles, std::vector<OnTiles> const& on,
                              std::array<Real*, 3> const& out) const = 0;
  /// The same, and move the particles by it.
  virtual std::int64_t push(Shape shape, ParticleView const& particles, std::vector<OnTiles> const& on,
                            Mover const& mover) const = 0;
};

}  // namespace amrpic
