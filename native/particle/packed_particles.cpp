#include "particle/packed_particles.hpp"

#include <algorithm>
#include <array>
#include <cstring>
#include <unordered_map>
#include <utility>

#include "base/brought.hpp"
#include "particle/home_word.hpp"

namespace amrpic {

namespace {

/// A number such that those of like size and sign are near each other: its sign is the last bit. `real_of` inverts it.
inline std::uint64_t ordered_bits(Real value) {
  std::uint64_t bits;
  std::memcpy(&bits, &value, sizeof bits);
  return bits << 1 | bits >> 63;
}
inline Real real_of(std::uint64_t ordered) {
  std::uint64_t const bits = ordered >> 1 | ordered << 63;
  Real out;
  std::memcpy(&out, &bits, sizeof out);
  return out;
}

/// Rows of numbers, one for each column, of which only what exceeds the column's least is kept, in as many bits as the
/// largest needs. What comes out is what went in, to the last bit (J. Goldstein et al., "Compressing Relations and
/// Indexes", ICDE 1998).
///
/// In words: the least of each column, the bits of each, eight of these to a word, and the rows without gaps.
template <std::size_t columns>
class BitColumns {
 public:
  using Row = std::array<std::uint64_t, columns>;

  /// The words for some rows; none for none.
  static std::vector<std::int64_t> packed(std::vector<Row> const& rows) {
    if (rows.empty()) return {};
    BitColumns const format(rows);
    std::vector<std::int64_t> out(header + (rows.size() * format.row_bits() + 63) / 64, 0);
    format.write(out.data());
    std::int64_t* to = out.data() + header;
    std::uint64_t word = 0;
    unsigned filled = 0;  // bits of it
    for (Row const& row : rows)
      for (std::size_t c = 0; c < columns; ++c) {
        std::uint64_t const value = row[c] - format.least_[c];
        word |= value << filled;
        filled += format.bits_[c];
        if (filled < 64) continue;
        *to++ = std::int64_t(word);
        filled -= 64;
        word = filled > 0 ? value >> (format.bits_[c] - filled) : 0;
      }
    if (filled > 0) *to = std::int64_t(word);
    return out;
  }

  /// Call f(row) for so many rows in these words. Returns the words behind them.
  template <class F>
  static std::int64_t const* unpack(std::int64_t const* words, std::size_t count, F&& f) {
    if (count == 0) return words;
    BitColumns const format(words);
    std::size_t at = 64 * header;
    for (std::size_t n = 0; n < count; ++n) {
      Row row;
      for (std::size_t c = 0; c < columns; ++c) {
        row[c] = format.least_[c] + get(words, at, format.bits_[c]);
        at += format.bits_[c];
      }
      f(row);
    }
    return words + (at + 63) / 64;
  }

 private:
  static constexpr std::size_t header = columns + (columns + 7) / 8;

  explicit BitColumns(std::vector<Row> const& rows) {
    Row most = least_ = rows.front();
    for (Row const& row : rows)
      for (std::size_t c = 0; c < columns; ++c) {
        least_[c] = std::min(least_[c], row[c]);
        most[c] = std::max(most[c], row[c]);
      }
    for (std::size_t c = 0; c < columns; ++c)
      for (std::uint64_t range = most[c] - least_[c]; range > 0; range >>= 1) ++bits_[c];
  }
  explicit BitColumns(std::int64_t const* words) {
    std::memcpy(least_.data(), words, sizeof least_);
    std::memcpy(bits_.data(), words + columns, sizeof bits_);
  }
  void write(std::int64_t* words) const {
    std::memcpy(words, least_.data(), sizeof least_);
    std::memcpy(words + columns, bits_.data(), sizeof bits_);
  }
  std::size_t row_bits() const { return std::accumulate(bits_.begin(), bits_.end(), std::size_t(0)); }

  /// The number of so many bits from a bit on.
  static std::uint64_t get(std::int64_t const* words, std::size_t at, unsigned bits) {
    if (bits == 0) return 0;
    std::size_t const word = at / 64, shift = at % 64;
    std::uint64_t out = std::uint64_t(words[word]) >> shift;
    if (shift + bits > 64) out |= std::uint64_t(words[word + 1]) << (64 - shift);
    return bits == 64 ? out : out & ((std::uint64_t(1) << bits) - 1);
  }

  Row least_;
  std::array<std::uint8_t, columns> bits_{};
};

using Leavers = std::vector<Destinations::Leaver>;

/// Where the numbers of a particle lie in a row; the weight, if any, comes last.
enum Column : std::size_t { position = 0, momentum = 3, id = 6, weight };

std::uint64_t word_of(Destinations::Leaver const& of) {
  return amrpic::word_of(of.home) << 1 | std::uint64_t(of.wrapped);
}

/// Put those of a brick side by side, in their order. Return a word and a number for each portion.
std::vector<std::int64_t> put_into_portions(Leavers& leavers) {
  std::vector<std::int64_t> out;
  std::vector<std::size_t> portion_of;  // of each leaver
  std::unordered_map<std::uint64_t, std::size_t> portions;
  portion_of.reserve(leavers.size());
  for (auto const& leaver : leavers) {
    auto const [at, is_new] = portions.try_emplace(word_of(leaver), portions.size());
    if (is_new) out.insert(out.end(), {std::int64_t(at->first), 0});
    ++out[2 * at->second + 1];
    portion_of.push_back(at->second);
  }
  std::vector<std::size_t> next(portions.size(), 0);
  for (std::size_t n = 1; n < next.size(); ++n) next[n] = next[n - 1] + std::size_t(out[2 * n - 1]);
  Leavers sorted(leavers.size());
  for (std::size_t n = 0; n < leavers.size(); ++n) sorted[next[portion_of[n]]++] = leavers[n];
  leavers = std::move(sorted);
  return out;
}

template <std::size_t columns>
typename BitColumns<columns>::Row row_of(Real3 const& x, ParticleView const& particles, LocalIndex n) {
  typename BitColumns<columns>::Row out;
  Real3 const p = particles.momentum_at(n);
  for (std::size_t d = 0; d < 3; ++d) out[position + d] = ordered_bits(x[d]), out[momentum + d] = ordered_bits(p[d]);
  out[id] = std::uint64_t(particles.id[n]);
  if constexpr (columns > weight) out[weight] = ordered_bits(particles.weight_of(n));
  return out;
}

template <std::size_t columns>
void pack_rows(ParticleMesh const& mesh, ParticleView const& particles, std::vector<Leavers>& leavers,
               LeavingParticles& out) {
  std::vector<typename BitColumns<columns>::Row> rows;
  for (std::size_t rank = 0; rank < leavers.size(); ++rank) {
    if (leavers[rank].empty()) continue;
    auto& announced = out.announced[int(rank)] = put_into_portions(leavers[rank]);
    rows.clear();
    rows.reserve(leavers[rank].size());
    for (auto const& leaver : leavers[rank]) {
      Real3 x = particles.at(leaver.place);
      if (leaver.wrapped) mesh.locator().wrap(x);
      out.finite = out.finite && is_finite(particles.momentum_at(leaver.place));
      rows.push_back(row_of<columns>(x, particles, leaver.place));
    }
    auto const& words = out.words[int(rank)] = BitColumns<columns>::packed(rows);
    announced.insert(announced.begin(), std::int64_t(words.size()));
  }
}

/// Take particles out of the words of all ranks, one after the other.
template <std::size_t columns>
void unpack_rows(std::vector<std::int64_t> const& words, Arrivals const& arrivals,
                 std::vector<LocalIndex> const& places, ParticleView const& out) {
  std::int64_t const* at = words.data();
  std::size_t portion = 0;
  std::int64_t done = 0;  // of it
  auto const take = [&](auto const& row) {
    if (done == arrivals.portions()[portion].count) ++portion, done = 0;
    std::int64_t const n = places[portion] + done++;
    for (std::size_t d = 0; d < 3; ++d) {
      out.position[d][n] = real_of(row[position + d]);
      if (out.momentum[d]) out.momentum[d][n] = real_of(row[momentum + d]);
    }
    out.id[n] = std::int64_t(row[id]);
    if constexpr (columns > weight)
      if (!out.equal_weights) out.weight[n] = real_of(row[weight]);
  };
  for (std::size_t rank = 0; rank + 1 < arrivals.starts.size(); ++rank)
    at = BitColumns<columns>::unpack(at, std::size_t(arrivals.count(rank)), take);
}

}  // namespace

LeavingParticles pack(ParticleMesh const& mesh, ParticleView const& particles, std::vector<Leavers>& leavers,
                      bool has_weights) {
  std::vector<std::int64_t> counts;
  for (auto const& to_rank : leavers) counts.push_back(std::int64_t(to_rank.size()));
  LeavingParticles out(counts);
  out.has_weights = has_weights;
  has_weights ? pack_rows<weight + 1>(mesh, particles, leavers, out) : pack_rows<weight>(mesh, particles, leavers, out);
  return out;
}

Arrivals announce(Communicator const& comm, LeavingParticles& leaving) {
  auto const announced = std::exchange(leaving.announced, {});
  return Arrivals(std::size_t(comm.ranks()), brought(comm, announced), leaving.has_weights);
}

Arrivals::Arrivals(std::size_t ranks, std::vector<std::pair<int, std::vector<std::int64_t>>> const& announced,
                   bool has_weights)
    : has_weights_(has_weights) {
  std::vector<std::int64_t> counts(ranks, 0);
  words_of_.assign(ranks, 0);
  for (auto const& [rank, list] : announced) {
    words_of_[std::size_t(rank)] = list.front();
    for (std::size_t n = 1; n < list.size(); n += 2) {
      std::uint64_t const word = std::uint64_t(list[n]);
      portions_.push_back({rank, home_of(word >> 1), (word & 1) != 0, list[n + 1]});
      counts[std::size_t(rank)] += list[n + 1];
    }
  }
  static_cast<Passing&>(*this) = Passing(counts);
}

void Arrivals::start(Communicator const& comm, LeavingParticles& leaving) {
  under_way_.reset(new UnderWay{{}, std::exchange(leaving.words, {}), {}});
  auto& [received, sent, messages] = *under_way_;
  received.resize(std::size_t(std::accumulate(words_of_.begin(), words_of_.end(), std::int64_t(0))));
  std::int64_t* to = received.data();
  for (int rank = 0; rank < comm.ranks(); ++rank) {
    std::size_t const words = std::size_t(words_of_[std::size_t(rank)]);
    if (words > 0) messages.receive(comm, to, words, rank);
    to += words;
  }
  for (auto const& [rank, words] : sent) messages.send(comm, words.data(), words.size(), rank);
}

void Arrivals::receive(std::vector<LocalIndex> const& places, ParticleView const& out) {
  std::unique_ptr<UnderWay> const done(under_way_.release());
  done->messages.wait_for_received();
  auto const& words = done->received;
  has_weights_ ? unpack_rows<weight + 1>(words, *this, places, out) : unpack_rows<weight>(words, *this, places, out);
  done->messages.wait_for_sent();
}

void exchange_rows(Communicator const& comm, std::size_t width, LeavingParticles const& leaving,
                   std::vector<Real> const& left, Arrivals const& arrivals, std::vector<Real>& arrived) {
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
