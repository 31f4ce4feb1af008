#include "particle/beam_amplitudes.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <numeric>

namespace amrpic {

namespace {

typedef std::uint64_t Key;  // the bits of a number that is not negative: in the same order as such numbers

// First bins: each a fraction of an octave of the amplitude over the typical one; the outer ones hold all beyond.
constexpr int bins_per_octave_log2 = 5, octaves = 64, first_bins_log2 = 6 + bins_per_octave_log2;
constexpr std::size_t first_bins = std::size_t(1) << first_bins_log2;
constexpr int first_shift = 52 - bins_per_octave_log2;  // a double has 52 bits behind its exponent
constexpr Key first_key = Key(1023 - octaves / 2) << 52;
constexpr Key last_key = Key(0x7FF) << 52;  // infinity
constexpr Real slack = 1e-12;               // of the weight: what sums may have lost
constexpr std::size_t most_sums = 8000;     // over ranks at a time: 64 KB

Key key_of(Real value) {
  value = value > 0 ? value : 0;  // rounding may leave less than nothing
  Key out;
  std::memcpy(&out, &value, sizeof out);
  return out;
}

Real value_of(Key key) {
  Real out;
  std::memcpy(&out, &key, sizeof out);
  return out;
}

std::size_t first_bin(Key key) {
  return key < first_key ? 0 : std::min<Key>((key - first_key) >> first_shift, first_bins - 1);
}

/// The amplitudes of a particle, or of eight; of distances their squares.
template <class T>
std::array<T, amplitude_kinds> amplitudes(AmplitudeFrame const& frame, std::array<T, 3> const& x,
                                          std::array<T, 3> const& u) {
  std::array<T, amplitude_kinds> out;
  std::array<T, 3> square;
  for (std::size_t d = 0; d < 3; ++d) {
    T const dx = x[d] - frame.centre[d], du = u[d] - frame.centre[d + 3];
    auto const& [a, b, c] = frame.forms[d];
    square[d] = dx * dx;
    out[d] = a * square[d] + b * (dx * du) + c * (du * du);
  }
  out[3] = square[0] + square[1];
  out[4] = out[3] + square[2];
  return out;
}

/// Call f(part, kind, key, weight) for the amplitudes of all particles, over the typical ones.
template <class F>
void for_each_amplitude(BeamView const& beam, BeamParts const& parts, AmplitudeFrame const* frames, F&& f) {
  std::vector<std::array<Real, amplitude_kinds>> scale(parts.count());
  for (std::size_t part = 0; part < scale.size(); ++part)
    for (std::size_t kind = 0; kind < amplitude_kinds; ++kind)
      scale[part][kind] = frames[part].typical[kind] == 0 ? 1 : 1 / frames[part].typical[kind];
  auto const report = [&](std::size_t part, std::size_t kind, Real value, Real weight) {
    if (scale[part][kind] == scale[part][kind]) f(part, kind, key_of(value), weight);
  };
  for_each_of_parts(
      beam, parts,
      [&](std::size_t part, BeamLanes const& eight) {
        auto const found = amplitudes(frames[part], eight.x, eight.u);
        for (std::size_t kind = 0; kind < amplitude_kinds; ++kind) {
          Lanes const values = found[kind] * scale[part][kind];
          for (int i = 0; i < lane_count; ++i) report(part, kind, values[i], eight.weight[i]);
        }
      },
      [&](std::size_t part, BeamLanes const& eight, int i) {
        auto const found = amplitudes(frames[part], Real3{eight.x[0][i], eight.x[1][i], eight.x[2][i]},
                                      Real3{eight.u[0][i], eight.u[1][i], eight.u[2][i]});
        for (std::size_t kind = 0; kind < amplitude_kinds; ++kind)
          report(part, kind, found[kind] * scale[part][kind], eight.weight[i]);
      });
}

/// The search for one quantile: it has a key between two, and those below have some weight.
struct Search {
  Key low, high;
  Real fraction;
  Real total;      // weight of all ranks
  Real below = 0;  // weight of what lies below

  bool is_open() const { return low < high; }
  void end_at(Key key) { low = high = key; }
  int shift(int log2) const {
    Key const span = high - low;
    int const bits = span == 0 ? 0 : 64 - __builtin_clzll(span);
    return std::max(bits - log2, 0);
  }

  /// Go on in the first bin at which the fraction is reached, the last with weight for all of it.
  void enter(Real const* weights, int log2) {
    Real const goal = fraction < 1 ? fraction * total * (1 - slack) : std::numeric_limits<Real>::infinity();
    Key last = 0;
    Real sum = below;
    for (Key bin = 0; bin < Key(1) << log2; ++bin) {
      if (!(weights[bin] > 0)) continue;
      last = bin;
      below = sum;
      sum += weights[bin];
      if (sum >= goal) break;
    }
    int const bits = shift(log2);
    low += last << bits;
    high = std::min(high, low + ((Key(1) << bits) - 1));
  }
};

struct Candidate {
  Key key;
  Real weight;
};

/// Bins, as a power of two, such that `rows` rows of them and `more` numbers each are summed over ranks at a time.
int bins_log2(Communicator const& comm, std::size_t rows, std::size_t more) {
  int out = first_bins_log2;
  while (comm.ranks() > 1 && out > 1 && rows * ((std::size_t(1) << out) + more) > most_sums) --out;
  return out;
}

/// Narrow all searches to one key each, that of candidates of some rank. Collective.
///
/// Each round sums weights in bins of what is left. A search ends early where all that is left of all ranks is one key
/// of one rank, which is summed with the zeros of the others, in halves that a Real holds.
void narrow(Communicator const& comm, std::vector<Search>& searches, std::vector<std::vector<Candidate>>& candidates) {
  std::vector<std::size_t> open;
  for (std::size_t t = 0; t < searches.size(); ++t) open.push_back(t);
  auto const is_closed = [&](std::size_t t) { return !searches[t].is_open(); };
  for (;;) {
    open.erase(std::remove_if(open.begin(), open.end(), is_closed), open.end());
    if (open.empty()) return;
    int const log2 = bins_log2(comm, open.size(), 3);
    std::size_t const bins = std::size_t(1) << log2, row = bins + 3;
    std::vector<Real> sums(open.size() * row);
    for (std::size_t n = 0; n < open.size(); ++n) {
      auto const& mine = candidates[open[n]];
      if (mine.empty()) continue;
      Search const& search = searches[open[n]];
      Real* const own = sums.data() + n * row;
      Key const first = mine.front().key;
      bool one = true;
      for (auto const& [key, weight] : mine) {
        own[(key - search.low) >> search.shift(log2)] += weight;
        one = one && key == first;
      }
      own[bins] = one ? 1 : 2;
      own[bins + 1] = Real(first >> 32);
      own[bins + 2] = Real(first & 0xFFFFFFFF);
    }
    comm.sum_each(sums);
    for (std::size_t n = 0; n < open.size(); ++n) {
      Search& search = searches[open[n]];
      Real const* const all = sums.data() + n * row;
      if (all[bins] == 1)
        search.end_at(Key(all[bins + 1]) << 32 | Key(all[bins + 2]));
      else
        search.enter(all, log2);
      auto& left = candidates[open[n]];
      auto const outside = [&](Candidate const& c) { return c.key < search.low || c.key > search.high; };
      left.erase(std::remove_if(left.begin(), left.end(), outside), left.end());
    }
  }
}

/// Searches among first bins, of which each has its bin in the end: `weights` holds those of this rank, of each kind.
std::vector<Search> find_first_bins(Communicator const& comm, std::vector<Real> const& weights,
                                    std::vector<Real> const& fractions) {
  std::size_t const kinds = weights.size() / first_bins;
  int const log2 = bins_log2(comm, kinds, 0), shift = first_bins_log2 - log2;
  std::vector<Real> sums(kinds << log2);
  for (std::size_t n = 0; n < weights.size(); ++n) sums[n >> shift] += weights[n];
  comm.sum_each(sums);
  std::vector<Search> out;
  std::vector<std::vector<Candidate>> candidates;
  for (std::size_t at = 0; at < kinds; ++at) {
    Real const* const all = sums.data() + (at << log2);
    for (Real fraction : fractions) {
      Search search{0, first_bins - 1, fraction, std::accumulate(all, all + (std::size_t(1) << log2), Real(0))};
      if (search.total > 0)
        search.enter(all, log2);
      else
        search.end_at(0);
      candidates.emplace_back();
      for (Key bin = search.low; bin <= search.high; ++bin)
        if (Real const weight = weights[at * first_bins + bin]; weight > 0) candidates.back().push_back({bin, weight});
      out.push_back(search);
    }
  }
  narrow(comm, out, candidates);
  return out;
}

}  // namespace

std::vector<Real> amplitude_quantiles(Communicator const& comm, BeamView const& beam,
                                      std::vector<BeamParts> const& layers, std::vector<AmplitudeFrame> const& frames,
                                      std::vector<Real> const& fractions) {
  auto const for_each = [&](auto const& f) {  // f(place of part and kind, key, weight)
    std::size_t first = 0;
    for (BeamParts const& parts : layers) {
      for_each_amplitude(beam, parts, frames.data() + first,
                         [&](std::size_t part, std::size_t kind, Key key, Real weight) {
                           f((first + part) * amplitude_kinds + kind, key, weight);
                         });
      first += parts.count();
    }
  };
  std::vector<Real> weights(frames.size() * amplitude_kinds * first_bins);
  for_each([&](std::size_t at, Key key, Real weight) { weights[at * first_bins + first_bin(key)] += weight; });
  auto searches = find_first_bins(comm, weights, fractions);

  std::vector<std::uint32_t> wanted(weights.size());  // a bit for each fraction whose search goes on in a first bin
  for (std::size_t t = 0; t < searches.size(); ++t) {
    auto& search = searches[t];
    if (!(search.total > 0)) continue;
    Key const bin = search.low;
    wanted[t / fractions.size() * first_bins + bin] |= std::uint32_t(1) << t % fractions.size();
    search.low = bin > 0 ? first_key + (bin << first_shift) : 0;
    search.high = bin < first_bins - 1 ? first_key + ((bin + 1) << first_shift) - 1 : last_key;
  }
  std::vector<std::vector<Candidate>> candidates(searches.size());
  for_each([&](std::size_t at, Key key, Real weight) {
    for_each_bit(wanted[at * first_bins + first_bin(key)], [&](int k) {
      if (weight > 0) candidates[at * fractions.size() + std::size_t(k)].push_back({key, weight});
    });
  });
  narrow(comm, searches, candidates);

  std::vector<Real> out(searches.size());
  for (std::size_t t = 0; t < out.size(); ++t) {
    std::size_t const at = t / fractions.size(), kind = at % amplitude_kinds;
    Real const typical = frames[at / amplitude_kinds].typical[kind];
    Real const value = value_of(searches[t].low) * (typical == 0 ? 1 : typical);
    out[t] = searches[t].total > 0 ? (kind < 3 ? value : std::sqrt(value)) : std::numeric_limits<Real>::quiet_NaN();
  }
  return out;
}

}  // namespace amrpic
