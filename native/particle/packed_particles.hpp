// Particles on their way to other ranks.
#pragma once

#include <cstdint>
#include <cstring>
#include <numeric>
#include <vector>

#include "particle/classify.hpp"

namespace amrpic {

/// Those to or from all ranks, rank after rank. A particle is packed in words of eight bytes, as few as hold it:
/// position, momentum, id, brick, and its weight unless all are equal.
class PackedParticles {
 public:
  /// `counts`: of each rank. `has_weights`: the same on all ranks.
  explicit PackedParticles(std::vector<std::int64_t> const& counts = {}, bool has_weights = false)
      : starts(counts.size() + 1, 0), width_(has_weights ? 9 : 8) {
    std::partial_sum(counts.begin(), counts.end(), starts.begin() + 1);
  }

  std::vector<std::int64_t> starts;  ///< of each rank; then the end
  std::int64_t count() const { return starts.back(); }
  std::int64_t count(std::size_t rank) const { return starts[rank + 1] - starts[rank]; }
  bool has_weights() const { return width_ == 9; }

  /// Make room for all.
  void allocate() { words_.resize(std::size_t(count()) * width_); }
  /// `wrapped`: it came through a periodic face.
  void set(std::int64_t n, Real3 const& position, Real3 const& momentum, Real weight, std::int64_t id, Home const& home,
           bool wrapped);

  Real position(std::int64_t n, int d) const { return real(n, d); }
  Real momentum(std::int64_t n, int d) const { return real(n, 3 + d); }
  std::int64_t id(std::int64_t n) const { return at(n)[6]; }
  Home home(std::int64_t n) const;
  bool is_wrapped(std::int64_t n) const { return (at(n)[7] & 1) != 0; }
  Real weight(std::int64_t n) const { return real(n, 8); }

  /// Of all, `width` of each.
  std::int64_t* words() { return words_.data(); }
  std::int64_t const* words() const { return words_.data(); }
  std::size_t width() const { return width_; }

 private:
  std::int64_t const* at(std::int64_t n) const { return words_.data() + std::size_t(n) * width_; }
  Real real(std::int64_t n, int word) const {
    Real out;
    std::memcpy(&out, at(n) + word, sizeof out);
    return out;
  }

  std::size_t width_;  ///< words of a particle
  std::vector<std::int64_t> words_;
};

/// Those that leave this rank, wrapped along periodic axes, with or without their weights. Local.
PackedParticles pack(ParticleMesh const& mesh, ParticleView const& particles,
                     std::vector<std::vector<Destinations::Leaver>> const& leavers, bool has_weights);

/// Let other ranks know how many will come to them. Return as many as will come here, not received yet. Collective.
PackedParticles announce(Communicator const& comm, PackedParticles const& leaving);

/// Send those that leave, and receive those announced. One message per pair of ranks that has any. Collective.
void exchange(Communicator const& comm, PackedParticles const& leaving, PackedParticles& arrivals);

/// Send rows of so many further numbers of those that leave, and receive those of the ones that arrive. Collective.
void exchange_rows(Communicator const& comm, std::size_t width, PackedParticles const& leaving,
                   std::vector<Real> const& left, PackedParticles const& arrivals, std::vector<Real>& arrived);

}  // namespace amrpic
