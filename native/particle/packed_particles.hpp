// Particles on their way to other ranks.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <numeric>
#include <utility>
#include <vector>

#include "base/communicator.hpp"
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

/// Particles that pass from one rank to another, all to the same brick: those that came through a periodic face, or the
/// others.
struct Portion {
  int rank;  ///< that they come from
  Home home;
  bool wrapped;
  std::int64_t count;
};

/// Those that leave this rank, as they travel: of each rank's, portion after portion, the columns of position, momentum
/// and id in as few bits as hold them (`BitColumns`), and of weights unless all are equal.
struct LeavingParticles : Passing {
  using Passing::Passing;
  // by rank, until they are sent
  std::map<int, std::vector<std::int64_t>> announced;  ///< how many words, then a word and a number for each portion
  std::map<int, std::vector<std::int64_t>> words;
  bool has_weights = false;  ///< the same on all ranks
  bool finite = true;        ///< whether all momenta are
};

/// Those that come to this rank: it is known how many come to which brick before they are there.
class Arrivals : public Passing {
 public:
  Arrivals() = default;
  /// `announced`: by some of so many ranks, in their order. `has_weights`: the same on all ranks.
  Arrivals(std::size_t ranks, std::vector<std::pair<int, std::vector<std::int64_t>>> const& announced,
           bool has_weights);

  /// In the order of ranks.
  std::vector<Portion> const& portions() const { return portions_; }

  /// Send those that leave, whose words are taken, and ask for these. One message per pair of ranks that has any.
  /// Local.
  void start(Communicator const& comm, LeavingParticles& leaving);
  /// Let messages move. Whoever computes meanwhile calls this at times.
  void poll() {
    if (under_way_) under_way_->messages.poll();
  }
  /// Wait for them, and write those of each portion into `out`, from its place on. Weights are written if there is one
  /// for each. Collective.
  void receive(std::vector<LocalIndex> const& places, ParticleView const& out);

 private:
  std::vector<Portion> portions_;
  std::vector<std::int64_t> words_of_;  ///< of each rank
  bool has_weights_ = false;
  /// From `start` until they are received. What is given up before, as when a rank fails, keeps its memory: messages
  /// may still read and write there, and waiting for other ranks might never end.
  struct UnderWay {
    std::vector<std::int64_t> received;             ///< words of all ranks
    std::map<int, std::vector<std::int64_t>> sent;  ///< by rank
    Messages messages;
  };
  struct GiveUp {
    void operator()(UnderWay*) const {}
  };
  std::unique_ptr<UnderWay, GiveUp> under_way_;
};

/// Those that leave this rank, wrapped along periodic axes, with or without their weights. `leavers` are put into the
/// order in which they travel. Local.
LeavingParticles pack(ParticleMesh const& mesh, ParticleView const& particles,
                      std::vector<std::vector<Destinations::Leaver>>& leavers, bool has_weights);

/// Let other ranks know how many will come to which of their bricks. Return what will come here. Collective.
Arrivals announce(Communicator const& comm, LeavingParticles& leaving);

/// Send rows of so many further numbers of those that leave, and receive those of the ones that arrive. Collective.
void exchange_rows(Communicator const& comm, std::size_t width, LeavingParticles const& leaving,
                   std::vector<Real> const& left, Arrivals const& arrivals, std::vector<Real>& arrived);

}  // namespace amrpic
