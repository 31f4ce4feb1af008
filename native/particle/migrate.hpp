#pragma once

#include <vector>

#include "particle/particle_mesh.hpp"
#include "particle/view.hpp"

namespace amrpic {

/// Particles on their way to the ranks that own their boxes. Those that stay are never copied on the way, only in the
/// end.
class Migration {
 public:
  /// Find the home of each particle, wrapped along periodic axes, and tell the ranks how many will come. Collective.
  /// The particles must live until `finish`.
  Migration(ParticleMesh& mesh, ParticleView const& particles);

  std::vector<std::int64_t> const& lost() const { return lost_; }  ///< places of those outside the domain
  std::vector<std::int64_t> const& not_finite() const {
    return not_finite_;
  }  ///< places of those without position or momentum
  std::int64_t arriving() const { return staying_ + received_start_.back(); }  ///< how many live here afterwards

  /// Send; then write this rank's particles into `out`, which has room for `arriving()`, sorted by slot, cell and id,
  /// and where each slot starts into `starts` (slots + 1 values). One message per pair of ranks that has any.
  /// Collective.
  void finish(ParticleView const& out, std::int64_t* starts);

 private:
  /// One particle as it is packed for a message.
  struct Parcel {
    Real3 position, momentum;
    Real weight;
    std::int64_t id;
    int level, box;
    LocalIndex cell;
  };
  void pack(std::int64_t n, Home const& home, Parcel& parcel) const;
  void exchange();
  void settle_received();
  std::vector<std::int64_t> sorted(std::int64_t* starts) const;
  std::int64_t id(std::int64_t n) const {
    return n < particles_.count ? particles_.id[n] : received_[n - particles_.count].id;
  }

  ParticleMesh& mesh_;
  ParticleView particles_;
  std::vector<std::int64_t> lost_, not_finite_;
  std::int64_t staying_ = 0;
  /// Where each particle will live here, -1: nowhere; first those that were here, then those received.
  std::vector<LocalIndex> slot_, cell_;
  std::vector<Parcel> leaving_, received_;  ///< by rank
  std::vector<std::int64_t> leaving_start_, received_start_;
};

/// Number of particles of this rank in each box of each level, over all boxes of the level.
std::vector<std::vector<std::int64_t>> count_per_box(Locator& locator, ParticleView const& particles);

}  // namespace amrpic
