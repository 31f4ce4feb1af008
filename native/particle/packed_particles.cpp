#include "particle/packed_particles.hpp"

#include <utility>

namespace amrpic {

namespace {

/// Bits of a brick in a word, above one that says whether the particle came through a periodic face. A box has at least
/// two cells along each axis and a rank at most 2^31, so that no box has 2^27 bricks.
constexpr int level_bits = 5, box_bits = 31, brick_bits = 27;
static_assert(1 + level_bits + box_bits + brick_bits == 64);

}  // namespace

void PackedParticles::set(std::int64_t n, Real3 const& position, Real3 const& momentum, Real weight, std::int64_t id,
                          Home const& home, bool wrapped) {
  std::int64_t* const to = words_.data() + std::size_t(n) * width_;
  std::memcpy(to, position.data(), sizeof position);
  std::memcpy(to + 3, momentum.data(), sizeof momentum);
  to[6] = id;
  std::uint64_t word = std::uint64_t(home.brick);
  word = word << box_bits | std::uint64_t(home.box);
  word = word << level_bits | std::uint64_t(home.level);
  word = word << 1 | std::uint64_t(wrapped);
  to[7] = std::int64_t(word);
  if (has_weights()) std::memcpy(to + 8, &weight, sizeof weight);
}

Home PackedParticles::home(std::int64_t n) const {
  auto const bits = [](std::uint64_t word, int count) { return int(word & ((std::uint64_t(1) << count) - 1)); };
  std::uint64_t const word = std::uint64_t(at(n)[7]) >> 1;
  return {bits(word, level_bits), bits(word >> level_bits, box_bits),
          bits(word >> (level_bits + box_bits), brick_bits)};
}

PackedParticles pack(ParticleMesh const& mesh, ParticleView const& particles,
                     std::vector<std::vector<Destinations::Leaver>> const& leavers, bool has_weights) {
  std::vector<std::int64_t> counts;
  for (auto const& to_rank : leavers) counts.push_back(std::int64_t(to_rank.size()));
  PackedParticles out(counts, has_weights);
  out.allocate();
  std::int64_t place = 0;
  for (auto const& to_rank : leavers)
    for (auto const& [n, home] : to_rank) {
      Real3 const before = particles.at(n);
      Real3 x = before;
      mesh.locator().wrap(x);
      out.set(place++, x, particles.momentum_at(n), particles.weight_of(n), particles.id[n], home, x != before);
    }
  return out;
}

PackedParticles announce(Communicator const& comm, PackedParticles const& leaving) {
  std::vector<std::pair<int, std::int64_t>> to;
  std::vector<std::int64_t> coming(std::size_t(comm.ranks()), 0);
  for (std::size_t r = 0; r < coming.size(); ++r)
    if (leaving.count(r) > 0) to.emplace_back(int(r), leaving.count(r));
  for (auto const& [rank, count] : comm.announced(to)) coming[std::size_t(rank)] = count;
  return PackedParticles(coming, leaving.has_weights());
}

namespace {

/// Rows of `width` values for each particle.
template <class T>
void exchange_all(Communicator const& comm, std::size_t width, PackedParticles const& leaving, T const* left,
                  PackedParticles const& arrivals, T* arrived) {
  Messages messages;
  for (int r = 0; r < comm.ranks(); ++r) {
    std::size_t const rank = std::size_t(r);
    if (std::size_t const n = width * std::size_t(arrivals.count(rank)); n > 0)
      messages.receive(comm, arrived + width * std::size_t(arrivals.starts[rank]), n, r);
    if (std::size_t const n = width * std::size_t(leaving.count(rank)); n > 0)
      messages.send(comm, left + width * std::size_t(leaving.starts[rank]), n, r);
  }
  messages.wait_for_all();
}

}  // namespace

void exchange(Communicator const& comm, PackedParticles const& leaving, PackedParticles& arrivals) {
  arrivals.allocate();
  exchange_all(comm, leaving.width(), leaving, leaving.words(), arrivals, arrivals.words());
}

void exchange_rows(Communicator const& comm, std::size_t width, PackedParticles const& leaving,
                   std::vector<Real> const& left, PackedParticles const& arrivals, std::vector<Real>& arrived) {
  arrived.resize(width * std::size_t(arrivals.count()));
  exchange_all(comm, width, leaving, left.data(), arrivals, arrived.data());
}

}  // namespace amrpic
