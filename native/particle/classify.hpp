#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "particle/array_pool.hpp"
#include "particle/particle_mesh.hpp"
#include "particle/view.hpp"

namespace amrpic {

/// Where each particle of this rank goes. It stays in the brick of its run, moves to another brick of this rank, leaves
/// for another rank, or is lost.
struct Destinations {
  /// Particles [first, last), consecutive in memory, that were compared with one brick; `first` is a multiple of eight.
  struct Run {
    LocalIndex brick, first, last, stayed;
  };
  struct Mover {
    LocalIndex place, brick;
  };
  struct Leaver {
    LocalIndex place;
    Home home;
  };

  // all in the order of the particles' places
  std::vector<Run> runs;
  Scratch<std::uint8_t> stays;               ///< for each eight particles, a bit for each that stayed
  std::vector<Mover> movers;                 ///< without those that came through a periodic face
  std::vector<Mover> wrapped;                ///< these
  std::vector<std::vector<Leaver>> leavers;  ///< by rank
  std::vector<std::int64_t> lost;            ///< places of those outside the domain
  std::vector<std::int64_t> per_brick;       ///< how many of this rank's particles will be in each of its bricks
  bool finite = true;                        ///< whether all positions are, and the momenta of those lost
};

/// Places of some particles, ascending, in memory that others own.
struct ParticleList {
  std::int64_t const *first, *last;
};

/// Find where each particle goes, wrapped along periodic axes; those that are `gone` go nowhere. Local.
Destinations classify(ParticleMesh& mesh, ParticleView const& particles, ParticleList const& gone);

/// Number of `count` particles of this rank in each box of each level, over all boxes of the level; those that are
/// outside the domain are not counted.
std::vector<std::vector<std::int64_t>> count_per_box(Locator& locator, std::array<Real*, 3> const& position,
                                                     std::int64_t count);

/// Whether all three are.
inline bool is_finite(Real3 const& v) { return std::isfinite(v[0]) && std::isfinite(v[1]) && std::isfinite(v[2]); }

}  // namespace amrpic
