#pragma once

#include <array>
#include <utility>
#include <vector>

#include "base/fetch.hpp"
#include "particle/array_pool.hpp"
#include "particle/home_box.hpp"
#include "particle/lane_groups.hpp"
#include "particle/particle_mesh.hpp"
#include "particle/view.hpp"

namespace amrpic {

/// Particles on their way to the ranks that own their boxes, and to their places there.
///
/// Particles that were sorted before they moved mostly lie in the brick of their neighbour in memory. So one pass
/// compares eight at a time with the current brick, and looks up only those that left it. Then it is known how many
/// live in each brick, and a second pass copies each particle once: what stays in a brick by vectors, the others one by
/// one. That is a counting sort, so the particles of a brick keep the order in which they came.
class Migration {
 public:
  /// Find the home of each particle, wrapped along periodic axes, and exchange how many will come. Collective.
  /// The particles must live until `finish`. Throws std::length_error on all ranks if one gets more than 2^31 of them.
  Migration(ParticleMesh& mesh, ParticleView const& particles);

  std::vector<std::int64_t> const& lost() const { return lost_; }              ///< places of those outside the domain
  std::int64_t arriving() const { return staying_ + received_start_.back(); }  ///< how many live here afterwards

  /// Send; then write this rank's particles into `out`, which has room for `arriving()`, sorted by slot and brick,
  /// those of a brick by the rank and the place where they were, what was wrapped behind the others; and where each
  /// slot starts into `starts` (slots + 1 values). One message per pair of ranks that has any. False if a position or
  /// momentum of those that were on this rank is not finite; then `out` means nothing. Equal weights are not written;
  /// if those of `out` are not equal, those of more than one particle here must not be. Collective.
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
  struct LocalBrick {
    int slot = -1, brick = -1;
  };
  /// Particles [first, last), consecutive in memory, that were compared with one brick; `first` is a multiple of eight.
  struct ParticleRun {
    LocalBrick at;
    LocalIndex first, last, stayed;
  };
  /// A particle that goes from a place on this rank to a brick of this rank, which is numbered among all of them.
  struct Mover {
    LocalIndex place, brick;
  };
  /// Movers in order of their places. Those that came through a periodic face are kept apart: they may come back into
  /// the very brick whose stayers, before and behind them, are copied at once; so they follow all others.
  struct Movers {
    bool wrapped;
    std::vector<Mover> all{};
    std::size_t assigned = 0;
  };
  /// Those of the particles [first, last) that stayed, from the place on where they are written.
  struct Stayers {
    LocalIndex first, last;
    std::int64_t to;
  };
  struct AssignedMover {
    LocalIndex from;
    std::int64_t to;
    bool wrapped;
  };
  /// Particles that have a place and are still to be copied.
  struct Assigned {
    std::vector<Stayers> stayers;
    std::vector<AssignedMover> movers;
    LocalIndex count = 0;  ///< of particles, also of those between stayers
  };

  /// Values that are copied from place to place, one for each particle. Ids are copied as numbers, since only the bytes
  /// count.
  struct Column {
    Real const* from;
    Real* to;
    bool is_momentum;
  };

  void compare();
  void compare(LaneGroup const& group);
  void find_leavers();
  HomeBox const& current_box() const { return mesh_.homes()[std::size_t(run_.at.slot)]; }
  unsigned outside(HomeBrick const& brick, LaneGroup const& group) const;
  unsigned begin_run(LaneGroup const& group, unsigned out);
  void end_run(LocalIndex last);
  LocalBrick find_in_neighbours(Real3 const& x) const;
  LocalBrick find(Real3 const& x);
  void move_to(LocalBrick const& at, LocalIndex n, Movers& movers);
  void look_up(LocalIndex n);
  void announce();
  void exchange();
  void assign_places(std::int64_t* starts);
  void pair_columns(ParticleView const& out);
  void assign_stayers(LocalBrick const& at, LocalIndex first, LocalIndex last);
  void assign_movers(Movers& movers, LocalIndex last);
  void copy_a_batch(LocalIndex more);
  void copy_assigned();
  void unpack(std::int64_t first, std::int64_t last, bool wrapped, ParticleView const& out);
  LocalIndex number(LocalBrick const& at) const { return first_brick_[std::size_t(at.slot)] + at.brick; }

  ParticleMesh& mesh_;
  ParticleView particles_;
  std::vector<Column> columns_;  ///< position, momentum, id, and weight if it is not equal; none before `finish`
  /// Of each slot: the number of its first brick among all of this rank, and how many there are.
  std::vector<LocalIndex> first_brick_;
  ParticleRun run_{{}, 0, 0, 0};    ///< of the current brick
  HomeBrick current_brick_{};       ///< at first one that contains nothing
  std::array<int, 27> neighbours_;  ///< slots found next to its box, by direction; -1: none yet
  /// Particles that left the current brick: looked up a few dozen at a time, so that the processor need not guess after
  /// each eight which these are.
  LocalIndex left_[block_size] = {};
  int left_count_ = 0;
  Home latest_;  ///< of the particle that was looked up last
  bool finite_ = true;
  std::vector<std::int64_t> lost_;
  std::int64_t staying_ = 0;
  std::vector<ParticleRun> runs_;  ///< in order of their places
  Scratch<std::uint8_t> stays_;    ///< for each eight particles, a bit for each that stayed in its run's brick
  Movers movers_{false}, wrapped_{true};
  Assigned assigned_;
  std::vector<std::vector<Leaving>> leaving_;  ///< by rank
  std::vector<Parcel> sent_, received_;        ///< by rank
  std::vector<std::int64_t> sent_start_, received_start_;
  /// Where the next particle of each brick is written; how many there are, until all are known.
  std::vector<std::int64_t> next_;
};

/// Number of `count` particles of this rank in each box of each level, over all boxes of the level; those that are
/// outside the domain are not counted.
std::vector<std::vector<std::int64_t>> count_per_box(Locator& locator, std::array<Real*, 3> const& position,
                                                     std::int64_t count);

}  // namespace amrpic
