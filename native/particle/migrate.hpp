#pragma once

#include <limits>
#include <vector>

#include "particle/classify.hpp"
#include "particle/lane_groups.hpp"
#include "particle/packed_particles.hpp"
#include "particle/servers.hpp"
#include "particle/sort.hpp"

namespace amrpic {

/// Places [first, last) of particles.
struct PlaceRange {
  std::int64_t first, last;
};

/// Particles on their way to the ranks that serve them, and to their places there: they are classified by where
/// they go, those that leave are exchanged, all are sorted, and each is copied once.
class Migration {
 public:
  static constexpr std::int64_t most = std::numeric_limits<LocalIndex>::max() - block_size;  ///< particles of a rank

  /// Find where each particle goes, wrapped along periodic axes, and how many will come. Collective. The particles must
  /// live until `start`; those that are `gone` are left out. There must not be more than `most` of them, nor may more
  /// than that arrive where `start` is called. `has_weights`: whether weights go with particles, since not all are
  /// equal; the same on all ranks.
  Migration(ParticleMesh& mesh, Servers servers, ParticleView const& particles, ParticleList const& gone,
            bool has_weights);

  std::vector<std::int64_t> const& lost() const { return destinations_.lost; }  ///< places of those outside the domain
  std::int64_t arriving() const { return staying_ + arrivals_.count(); }        ///< how many live here afterwards
  std::int64_t from_others() const { return arrivals_.count(); }  ///< how many of these come from other ranks
  std::int64_t bricks() const;                                    ///< how many hold particles that were on this rank

  /// Send those that leave, and write the others into `out`, which has room for `arriving()`, in the order of `Places`.
  /// Of those that are `under_way` to this rank the positions alone are set, to the middles of their bricks, until they
  /// are received. Whoever computes in between calls `poll` at times. False if a position or momentum of those that
  /// were on this rank is not finite; then `out` means nothing. Equal weights are not written; if those of `out` are
  /// not equal, those of more than one particle here must not be. Local.
  bool start(ParticleView const& out);
  std::vector<PlaceRange> under_way() const;
  void poll() { arrivals_.poll(); }
  void receive(ParticleView const& out);  ///< collective

  // after `start`, and `carry` after `receive`:
  /// Write further columns of eight bytes of this rank's particles into `to`, in the same order. Collective; once for
  /// each set of columns, of which all ranks have as many.
  void carry(std::vector<Real const*> const& from, std::vector<Real*> const& to) const;

  std::vector<std::int64_t> const& starts() const { return places_.slots; }  ///< of each slot, and of one more
  std::vector<Home> const& remote() const { return places_.remote; }         ///< bricks of the last slots
  std::vector<int> first_servers() const;                                    ///< of these

 private:
  void put_into_middles(ParticleView const& out) const;

  ParticleMesh& mesh_;
  Servers servers_;
  ParticleView particles_;
  Destinations destinations_;
  std::int64_t staying_ = 0;
  LeavingParticles leaving_;
  Arrivals arrivals_;
  Places places_;
};

}  // namespace amrpic
