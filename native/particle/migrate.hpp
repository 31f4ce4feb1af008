#pragma once

#include <array>
#include <utility>
#include <vector>

#include "particle/home_box.hpp"
#include "particle/lanes.hpp"
#include "particle/memory.hpp"
#include "particle/particle_mesh.hpp"
#include "particle/view.hpp"

namespace amrpic {

/// Particles on their way to the ranks that own their boxes, and to their places there.
///
/// Particles that were sorted before they moved mostly lie in the brick of their neighbour in memory. So one pass holds
/// eight at a time against the brick at hand, and only those that left it are looked up. Then it is known how many live
/// in each brick, and a second pass copies each particle once: what stays in a brick by vectors, the others one by one.
/// That is a counting sort, so the particles of a brick keep the order in which they came.
class Migration {
 public:
  /// Find the home of each particle, wrapped along periodic axes, and tell the ranks how many will come. Collective.
  /// The particles must live until `finish`. Throws std::length_error if a rank gets more than 2^31 of them.
  Migration(ParticleMesh& mesh, ParticleView const& particles);

  std::vector<std::int64_t> const& lost() const { return lost_; }              ///< places of those outside the domain
  std::int64_t arriving() const { return staying_ + received_start_.back(); }  ///< how many live here afterwards

  /// Send; then write this rank's particles into `out`, which has room for `arriving()`, sorted by slot and brick,
  /// those of a brick by the rank and the place where they were, what was wrapped behind the others; and where each
  /// slot starts into `starts` (slots + 1 values). One message per pair of ranks that has any. False if a position or
  /// momentum of those that were on this rank is not finite; then `out` means nothing. Collective.
  bool finish(ParticleView const& out, std::int64_t* starts);

 private:
  /// One particle as it is packed for a message.
  struct Parcel {
    Real3 position, momentum;
    Real weight;
    std::int64_t id;
    int level, box, brick;
    bool wrapped;
  };
  struct Leaving {
    LocalIndex place;
    Home home;
  };
  /// A brick of this rank; none if negative.
  struct Place {
    int slot = -1, brick = -1;
  };
  /// Particles [first, last), consecutive in memory, that were held against one brick; `first` is a multiple of eight.
  struct Run {
    Place at;
    LocalIndex first, last, stayed;
  };
  /// A particle that comes into a brick of this rank, from a place on it.
  struct Mover {
    LocalIndex place, brick;
  };
  /// Those in order of their places.
  struct Movers {
    bool wrapped;  ///< they came through a periodic face, and are yet where they were before it
    std::vector<Mover> all{};
    std::size_t copied = 0;
  };

  void hold();
  void hold(LaneGroup const& group);
  void look_after();
  unsigned outside(HomeBrick const& brick, LaneGroup const& group) const;
  unsigned begin_run(LaneGroup const& group, unsigned out);
  void end_run(LocalIndex last);
  Place next_door(Real3 const& x) const;
  Place find(Real3 const& x);
  void move_to(Place const& place, LocalIndex n, Movers& movers);
  void look_up(LocalIndex n);
  void announce();
  void exchange();
  void count(std::int64_t* starts);
  template <bool far>
  void copy_stayers(Run const& run, ParticleView const& out);
  void copy_movers(Movers& movers, LocalIndex last, ParticleView const& out);
  void unpack(std::int64_t first, std::int64_t last, bool wrapped, ParticleView const& out);
  LocalIndex number(Place const& at) const { return first_brick_[std::size_t(at.slot)] + at.brick; }

  ParticleMesh& mesh_;
  ParticleView particles_;
  std::vector<LocalIndex>
      first_brick_;                ///< of each slot: its number among all bricks of this rank, and how many there are
  Run run_{{}, 0, 0, 0};           ///< of the brick at hand
  HomeBrick at_hand_{};            ///< that brick; at first one that holds nothing
  std::array<int, 27> next_door_;  ///< slots found around its box, by direction; -1: none yet
  /// Who left the brick at hand: looked after a few dozen at a time, so that the processor need not guess after each
  /// eight who that is.
  LocalIndex left_[block_size] = {};
  int left_count_ = 0;
  Home latest_;  ///< of the particle that was looked up last
  bool finite_ = true;
  std::vector<std::int64_t> lost_;
  std::int64_t staying_ = 0;
  std::vector<Run> runs_;        ///< in order of their places
  Scratch<std::uint8_t> stays_;  ///< for each eight particles, a bit for each that stayed in its run's brick
  Movers movers_{false}, wrapped_{true};
  std::vector<std::vector<Leaving>> leaving_;  ///< by rank
  std::vector<Parcel> sent_, received_;        ///< by rank
  std::vector<std::int64_t> sent_start_, received_start_;
  std::vector<std::int64_t>
      next_;  ///< where the next particle of each brick is written; how many there are, until all are known
};

/// Number of particles of this rank in each box of each level, over all boxes of the level.
std::vector<std::vector<std::int64_t>> count_per_box(Locator& locator, ParticleView const& particles);

}  // namespace amrpic
