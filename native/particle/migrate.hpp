#pragma once

#include <optional>
#include <vector>

#include "particle/lanes.hpp"
#include "particle/memory.hpp"
#include "particle/particle_mesh.hpp"
#include "particle/view.hpp"

namespace amrpic {

/// Particles on their way to the ranks that own their boxes, and to their places there.
///
/// Particles that were sorted before they moved mostly lie in the box, and often in the cell, of their neighbour in
/// memory. So one pass takes each particle's cell from the box at hand and counts the particles of each cell; only
/// those that left the box are looked up. Running sums of the counts are the places, and each particle is copied once.
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
    LocalIndex first, stride_y, stride_z;
    IndexLanes cells(std::array<Lanes, 3> const& x) const;
  };
  struct Leaving {
    std::int64_t place;
    Home home;
  };

  void bin(std::int64_t first, std::int64_t last);
  void look_up(std::int64_t n);
  std::optional<PlainBox> plain(Home const& home) const;
  LocalIndex cell_number(int level, int box, LocalIndex cell) const {
    return mesh_.first_cell()[mesh_.slot(level, box)] + cell;
  }
  void announce();
  void exchange();
  void place(std::int64_t* starts);
  void prefetch(std::int64_t first, std::int64_t last) const;
  void sort_cells(LocalIndex from, LocalIndex to, LocalIndex kept);
  void copy(std::int64_t first, LocalIndex count, ParticleView const& out);

  ParticleMesh& mesh_;
  ParticleView particles_;
  Home latest_;                   ///< of the particle that was looked up last
  std::optional<PlainBox> near_;  ///< the box at hand
  bool finite_ = true;
  std::vector<std::int64_t> lost_;
  std::int64_t staying_ = 0;
  Scratch<LocalIndex> cell_;  ///< of each particle that stays, among this rank's cells; -1: it does not stay
  /// Where each cell starts, one value more. Before that, value c + 1 is how many particles cell c has, then where the
  /// next one of them goes.
  Scratch<LocalIndex> start_;
  Scratch<LocalIndex> order_;                   ///< place in the old arrays, or beyond them among those received
  std::vector<std::vector<Leaving>> leaving_;   ///< by rank; this one too, for those that were wrapped
  std::vector<Parcel> sent_, received_;         ///< by rank
  std::vector<std::int64_t> unsorted_id_, id_;  ///< of the cells that are being copied
  std::vector<LocalIndex> source_;              ///< likewise, sorted: places in the old arrays
  std::vector<std::int64_t> sent_start_, received_start_;
};

/// Number of particles of this rank in each box of each level, over all boxes of the level.
std::vector<std::vector<std::int64_t>> count_per_box(Locator& locator, ParticleView const& particles);

}  // namespace amrpic
