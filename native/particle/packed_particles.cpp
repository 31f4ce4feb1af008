#include "particle/packed_particles.hpp"

#include <utility>

#include "particle/bit_columns.hpp"
#include "particle/home_word.hpp"

namespace amrpic {

void PackedParticles::set(std::int64_t n, Real3 const& position, Real3 const& momentum, Real weight, std::int64_t id,
                          Home const& home, bool wrapped) {
  std::int64_t* const to = words_.data() + std::size_t(n) * width_;
  std::memcpy(to, position.data(), sizeof position);
  std::memcpy(to + 3, momentum.data(), sizeof momentum);
  to[6] = id;
  to[7] = std::int64_t(word_of(home) << 1 | std::uint64_t(wrapped));
  if (has_weights()) std::memcpy(to + 8, &weight, sizeof weight);
}

Home PackedParticles::home(std::int64_t n) const { return home_of(std::uint64_t(at(n)[7]) >> 1); }

namespace {

/// Where the numbers of a particle lie in a row; the weight, if any, comes last.
enum Column : std::size_t { position = 0, momentum = 3, id = 6, level, box, brick, wrapped, weight };

template <std::size_t columns>
typename BitColumns<columns>::Row row_of(Real3 const& x, ParticleView const& particles, LocalIndex n, Home const& home,
                                         bool is_wrapped) {
  typename BitColumns<columns>::Row out;
  Real3 const p = particles.momentum_at(n);
  for (std::size_t d = 0; d < 3; ++d) out[position + d] = ordered_bits(x[d]), out[momentum + d] = ordered_bits(p[d]);
  out[id] = std::uint64_t(particles.id[n]);
  out[level] = std::uint64_t(home.level);
  out[box] = std::uint64_t(home.box);
  out[brick] = std::uint64_t(home.brick);
  out[wrapped] = std::uint64_t(is_wrapped);
  if constexpr (columns > weight) out[weight] = ordered_bits(particles.weight_of(n));
  return out;
}

template <std::size_t columns>
void pack_rows(ParticleMesh const& mesh, ParticleView const& particles,
               std::vector<std::vector<Destinations::Leaver>> const& leavers, LeavingParticles& out) {
  std::vector<typename BitColumns<columns>::Row> rows;
  for (std::size_t rank = 0; rank < leavers.size(); ++rank) {
    if (leavers[rank].empty()) continue;
    rows.clear();
    rows.reserve(leavers[rank].size());
    for (auto const& [n, home] : leavers[rank]) {
      Real3 const before = particles.at(n);
      Real3 x = before;
      mesh.locator().wrap(x);
      out.finite = out.finite && is_finite(particles.momentum_at(n));
      rows.push_back(row_of<columns>(x, particles, n, home, x != before));
    }
    out.words[int(rank)] = BitColumns<columns>::packed(rows);
  }
}

/// Take particles out of the words of all ranks, one after the other.
template <std::size_t columns>
void unpack_rows(std::vector<std::int64_t> const& words, PackedParticles& out) {
  std::int64_t const* at = words.data();
  std::int64_t n = 0;
  for (std::size_t rank = 0; rank + 1 < out.starts.size(); ++rank)
    at = BitColumns<columns>::unpack(at, std::size_t(out.count(rank)), [&](auto const& row) {
      Real3 x, p;
      for (std::size_t d = 0; d < 3; ++d) x[d] = real_of(row[position + d]), p[d] = real_of(row[momentum + d]);
      Real own = 0;
      if constexpr (columns > weight) own = real_of(row[weight]);
      out.set(n++, x, p, own, std::int64_t(row[id]), {int(row[level]), int(row[box]), int(row[brick])},
              row[wrapped] != 0);
    });
}

}  // namespace

LeavingParticles pack(ParticleMesh const& mesh, ParticleView const& particles,
                      std::vector<std::vector<Destinations::Leaver>> const& leavers, bool has_weights) {
  std::vector<std::int64_t> counts;
  for (auto const& to_rank : leavers) counts.push_back(std::int64_t(to_rank.size()));
  LeavingParticles out(counts);
  out.has_weights = has_weights;
  has_weights ? pack_rows<weight + 1>(mesh, particles, leavers, out) : pack_rows<weight>(mesh, particles, leavers, out);
  return out;
}

PackedParticles announce(Communicator const& comm, LeavingParticles const& leaving) {
  std::vector<std::pair<int, std::int64_t>> to;
  std::vector<std::int64_t> coming(std::size_t(comm.ranks()), 0);
  for (std::size_t r = 0; r < coming.size(); ++r)
    if (leaving.count(r) > 0) to.emplace_back(int(r), leaving.count(r));
  for (auto const& [rank, count] : comm.announced(to)) coming[std::size_t(rank)] = count;
  return PackedParticles(coming, leaving.has_weights);
}

void exchange(Communicator const& comm, LeavingParticles& leaving, PackedParticles& arrivals) {
  std::vector<int> from;
  for (std::size_t r = 0; r + 1 < arrivals.starts.size(); ++r)
    if (arrivals.count(r) > 0) from.push_back(int(r));
  auto const words = comm.swapped(leaving.words, from);
  leaving.words.clear();
  arrivals.allocate();
  if (words.empty()) return;  // nothing came, or to a virtual rank
  arrivals.has_weights() ? unpack_rows<weight + 1>(words, arrivals) : unpack_rows<weight>(words, arrivals);
}

void exchange_rows(Communicator const& comm, std::size_t width, LeavingParticles const& leaving,
                   std::vector<Real> const& left, PackedParticles const& arrivals, std::vector<Real>& arrived) {
  arrived.resize(width * std::size_t(arrivals.count()));
  Messages messages;
  for (int r = 0; r < comm.ranks(); ++r) {
    std::size_t const rank = std::size_t(r);
    if (std::size_t const n = width * std::size_t(arrivals.count(rank)); n > 0)
      messages.receive(comm, arrived.data() + width * std::size_t(arrivals.starts[rank]), n, r);
    if (std::size_t const n = width * std::size_t(leaving.count(rank)); n > 0)
      messages.send(comm, left.data() + width * std::size_t(leaving.starts[rank]), n, r);
  }
  messages.wait_for_all();
}

}  // namespace amrpic
