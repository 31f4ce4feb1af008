#pragma once

#include <cstdint>
#include <vector>

#include "particle/lanes.hpp"
#include "particle/view.hpp"

namespace amrpic {

/// Particles that are to be written in a new order, while most of them keep the one that they have.
///
/// Those come from groups of eight places, of whom some are left out; the others, the movers, are mixed in between. So
/// old arrays are read and new ones written by vectors, with a bit for each particle, and no branch depends on who goes
/// where.
class Rearrangement {
 public:
  explicit Rearrangement(ParticleView const& from) : from_(from) {}

  /// Those of the eight places from `first` on, a multiple of eight, whose bits are set come next, in order.
  void keep(LocalIndex first, unsigned bits) { groups_.push_back({first, bits}); }
  /// The particle at `place` becomes the nth one of all; ascending. A place beyond the old arrays stands for a particle
  /// that is written by someone else.
  void insert(LocalIndex place, std::int64_t n);
  /// Close a part of so many particles: as many as were kept and inserted since the last one.
  void close(LocalIndex count) { known_ += count; }
  std::int64_t known() const { return known_; }

  /// Write what is known, but for the last few, past the cache if the new arrays are `far`; whether momenta are finite.
  bool write_most(ParticleView const& out, bool far);
  /// The same of all.
  bool write_rest(ParticleView const& out, bool far);

 private:
  struct Group {
    LocalIndex first;
    unsigned bits;
  };
  /// So many particles of whom one column is written after the other.
  struct Part;

  bool write_while(LocalIndex least, ParticleView const& out, bool far);
  template <bool far>
  bool write(LocalIndex count, ParticleView const& out);
  template <bool far>
  bool write_column(Part const& part, Real const* from, Real* to, Real* carry, bool check) const;
  void forget_written();

  ParticleView from_;
  std::int64_t known_ = 0, written_ = 0;
  // Of those that are yet to be written, and some before them.
  std::vector<std::uint8_t> moved_;  ///< a bit for each: whether it is a mover
  std::int64_t first_moved_ = 0;     ///< who the first bit stands for, a multiple of eight
  std::vector<Group> groups_;
  std::vector<LocalIndex> movers_;
  std::size_t groups_written_ = 0, movers_written_ = 0;
  // Those of the last group that were left over.
  LocalIndex carried_ = 0;
  Real carry_[8][lane_count] = {};  ///< by column
};

}  // namespace amrpic
