#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <unordered_map>
#include <vector>

#include "particle/array_pool.hpp"
#include "particle/particle_mesh.hpp"
#include "particle/servers.hpp"
#include "particle/view.hpp"

namespace amrpic {

/// Numbers of the bricks in which this rank has particles: those of its own boxes have one from the start, see
/// `ParticleMesh`, and remote ones get the next as they are met.
class BrickNumbers {
 public:
  explicit BrickNumbers(ParticleMesh const& mesh) : mesh_(&mesh) {}

  bool is_own(Home const& brick) const { return level(brick).owner(brick.box) == level(brick).rank(); }
  LocalIndex number(Home const& brick);
  std::vector<Home> const& remote() const { return remote_; }  ///< in the order of their numbers

 private:
  Level const& level(Home const& brick) const { return mesh_->hierarchy().level(brick.level); }

  ParticleMesh const* mesh_;
  std::vector<Home> remote_;
  std::unordered_map<std::uint64_t, LocalIndex> place_;  ///< among these
};

/// Where each particle of this rank goes. It stays in the brick of its run, moves to another brick whose particles this
/// rank serves, leaves for another rank, or is lost.
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
    bool wrapped;  ///< whether it came through a periodic face
  };

  explicit Destinations(ParticleMesh const& mesh) : bricks(mesh) {}

  BrickNumbers bricks;
  // each list in the order of the particles' places; `pack` sorts leavers by brick
  std::vector<Run> runs;
  Scratch<std::uint8_t> stays;               ///< for each eight particles, a bit for each that stayed
  std::vector<Mover> movers;                 ///< without those that came through a periodic face
  std::vector<Mover> wrapped;                ///< these
  std::vector<std::vector<Leaver>> leavers;  ///< by rank
  std::vector<std::int64_t> lost;            ///< places of those outside the domain
  std::vector<std::int64_t> per_brick;       ///< how many of this rank's particles will be in each brick, by number
  bool finite = true;                        ///< whether all positions are, and the momenta of those lost
};

/// Places of some particles, ascending, in memory that others own.
struct ParticleList {
  std::int64_t const *first, *last;
};

/// Find where each particle goes, wrapped along periodic axes; those that are `gone` go nowhere. Local.
Destinations classify(ParticleMesh& mesh, Servers const& servers, ParticleView const& particles,
                      ParticleList const& gone);

/// Whether all three are.
inline bool is_finite(Real3 const& v) { return std::isfinite(v[0]) && std::isfinite(v[1]) && std::isfinite(v[2]); }

}  // namespace amrpic
