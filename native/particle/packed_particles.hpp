// Particles on their way to other ranks.
#pragma once

#include <cstdint>
#include <cstring>
#include <map>
#include <numeric>
#include <vector>

#include "particle/classify.hpp"

namespace amrpic {

/// How many particles pass between this rank and each other one, rank after rank.
class Passing {
 public:
  explicit Passing(std::vector<std::int64_t> const& counts = {}) : starts(counts.size() + 1, 0) {
    std::partial_sum(counts.begin(), counts.end(), starts.begin() + 1);
  }

  std::vector<std::int64_t> starts;  ///< of each rank; then the end
  std::int64_t count() const { return starts.back(); }
  std::int64_t count(std::size_t rank) const { return starts[rank + 1] - starts[rank]; }
};

/// Those that leave this rank, as they travel: of each rank's the columns of position, momentum, id and brick in as few
/// bits as hold them (`BitColumns`), and of weights unless all are equal.
struct LeavingParticles : Passing {
  using Passing::Passing;
  std::map<int, std::vector<std::int64_t>> words;  ///< by rank, until they are sent
  bool has_weights = false;                        ///< the same on all ranks
  bool finite = true;                              ///< whether all momenta are
};

/// Those that come to this rank: each in words of eight bytes, position, momentum, id, brick, and its weight unless all
/// are equal.
class PackedParticles : public Passing {
 public:
  /// `counts`: of each rank. `has_weights`: the same on all ranks.
  explicit PackedParticles(std::vector<std::int64_t> const& counts = {}, bool has_weights = false)
      : Passing(counts), width_(has_weights ? 9 : 8) {}

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
LeavingParticles pack(ParticleMesh const& mesh, ParticleView const& particles,
                      std::vector<std::vector<Destinations::Leaver>> const& leavers, bool has_weights);

/// Let other ranks know how many will come to them. Return as many as will come here, not received yet. Collective.
PackedParticles announce(Communicator const& comm, LeavingParticles const& leaving);

/// Send those that leave, and receive those announced. One message per pair of ranks that has any. Collective.
void exchange(Communicator const& comm, LeavingParticles& leaving, PackedParticles& arrivals);

/// Send rows of so many further numbers of those that leave, and receive those of the ones that arrive. Collective.
void exchange_rows(Communicator const& comm, std::size_t width, LeavingParticles const& leaving,
                   std::vector<Real> const& left, PackedParticles const& arrivals, std::vector<Real>& arrived);

}  // namespace amrpic
