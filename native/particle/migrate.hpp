#pragma once

#include <optional>
#include <utility>
#include <vector>

#include "particle/id_sort.hpp"
#include "particle/lanes.hpp"
#include "particle/memory.hpp"
#include "particle/particle_mesh.hpp"
#include "particle/view.hpp"

namespace amrpic {

/// Particles on their way to the ranks that own their boxes, and to their places there.
///
/// Particles that were sorted before they moved mostly lie in the box of their neighbour in memory. So one pass takes
/// each particle's cell from the box at hand; only those that left it are looked up. Box by box, what stayed and what
/// came in is then counted by cell, so that the counts remain in the cache; their running sums are the places, and each
/// particle is copied once.
class Migration {
 public:
  /// Find the home of each particle, wrapped along periodic axes, and tell the ranks how many will come. Collective.
  /// The particles must live until `finish`. Throws std::length_error if a rank gets more than 2^31 of them.
  Migration(ParticleMesh& mesh, ParticleView const& particles);

  std::vector<std::int64_t> const& lost() const { return lost_; }              ///< places of those outside the domain
  std::int64_t arriving() const { return staying_ + received_start_.back(); }  ///< how many live here afterwards

  /// Send; then write this rank's particles into `out`, which has room for `arriving()`, sorted by slot, cell and id,
  /// and where each slot starts into `starts` (slots + 1 values). One message per pair of ranks that has any. False if
  /// a position or momentum of those that were on this rank is not finite; then `out` means nothing. Collective.
  bool finish(ParticleView const& out, std::int64_t* starts);

 private:
  /// One particle as it is packed for a message.
  struct Parcel {
    Real3 position, momentum;
    Real weight;
    std::int64_t id;
    int level, box;
    LocalIndex cell;
  };
  /// A box of this rank that no finer one overlaps: a particle between its corners lives there.
  struct PlainBox {
    LevelCoordinates coordinates;
    Real3 lower, upper;  ///< corners, in the level's coordinates
    int level, box;
    LocalIndex stride_y, stride_z;
    IndexLanes cells(std::array<Lanes, 3> const& x) const;
    LocalIndex cell(Real3 const& x) const;
  };
  struct Leaving {
    std::int64_t place;
    Home home;
  };
  /// Particles [first, last), consecutive in memory, whose cells were taken from one box.
  struct Run {
    LocalIndex first, last;
  };
  /// A particle that comes into a box from elsewhere: its place in the old arrays, or beyond them among those received.
  struct Mover {
    LocalIndex cell, place;
  };
  /// What becomes of one box.
  struct Slot {
    std::vector<Run> runs;
    std::vector<Mover> movers;
    LocalIndex stayed = 0;
  };

  void bin(LocalIndex first, LocalIndex last);
  void look_up(LocalIndex n);
  bool went_next_door(LocalIndex n);
  void move_to(int slot, LocalIndex cell, LocalIndex n);
  int direction(Real3 const& x) const;
  std::optional<PlainBox> plain(Home const& home) const;
  void announce();
  void exchange();
  void count_by_cell(Slot const& slot, LocalIndex cells);
  void place(Slot const& slot, LocalIndex cells);
  void write_box(Slot const& slot, LocalIndex cells, bool last_of_all, ParticleView const& out);
  std::pair<LocalIndex, LocalIndex> wanted(Slot const& slot, LocalIndex first, LocalIndex last);
  void sort_cells(LocalIndex from, LocalIndex to);
  void read_ids(Keyed const& at, LocalIndex count) const;
  void copy(LocalIndex count, std::pair<LocalIndex, LocalIndex> const& ahead, ParticleView const& out);

  ParticleMesh& mesh_;
  ParticleView particles_;
  Home latest_;                                        ///< of the particle that was looked up last
  std::optional<PlainBox> near_;                       ///< the box at hand
  std::array<std::optional<PlainBox>, 27> next_door_;  ///< those found around it, by direction
  bool finite_ = true;
  std::vector<std::int64_t> lost_;
  std::int64_t staying_ = 0;
  Scratch<LocalIndex> cell_;  ///< of each particle in the box of its run; -1: it does not stay there
  std::vector<Slot> slots_;
  std::vector<std::vector<Leaving>> leaving_;  ///< by rank; this one too, for those that were wrapped
  std::vector<Parcel> sent_, received_;        ///< by rank
  std::vector<std::int64_t> sent_start_, received_start_;

  // Of the box that is being written.
  std::vector<LocalIndex> count_;  ///< where each cell starts, see `count_by_cell` and `place`
  std::vector<LocalIndex> order_;  ///< places of its particles, sorted by cell
  LocalIndex near_to_ = 0;         ///< up to where the old arrays were asked for
  // Of the cells that are being copied, and before them what is left over of those before.
  std::vector<std::int64_t> id_;
  std::vector<LocalIndex> source_;
  LocalIndex kept_ = 0;       ///< how many are left over
  std::int64_t written_ = 0;  ///< how many are written
};

/// Number of particles of this rank in each box of each level, over all boxes of the level.
std::vector<std::vector<std::int64_t>> count_per_box(Locator& locator, ParticleView const& particles);

}  // namespace amrpic
