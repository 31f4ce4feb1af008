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
constexpr int bins_per_octave_log2 = 5, octaves = 64, first_bins = octaves << bins_per_octave_log2;
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

int first_bin(Key key) {
  return key < first_key ? 0 : int(std::min<Key>((key - first_key) >> first_shift, first_bins - 1));
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
void for_each_amplitude(BeamView const& beam, BeamParts const& parts, std::vector<AmplitudeFrame> const& frames,
                        F&& f) {
  std::vector<std::array<Real, amplitude_kinds>> scale(frames.size());
  for (std::size_t part = 0; part < frames.size(); ++part)
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
  Real below = 0, total = 0;  // weight, of all ranks

  bool is_open() const { return low < high; }
  void end_at(Key key) { low = high = key; }
  int shift(int bins_log2) const {
    Key const span = high - low;
    int const bits = span == 0 ? 0 : 64 - __builtin_clzll(span);
    return std::max(bits - bins_log2, 0);
  }

  /// Go on in the first bin at which the fraction is reached, the last with weight for all of it.
  void enter(Real const* weights, int bins_log2) {
    Real const goal = fraction < 1 ? fraction * total * (1 - slack) : std::numeric_limits<Real>::infinity();
    Key last = 0;
    Real sum = below;
    for (Key bin = 0; bin < Key(1) << bins_log2; ++bin) {
      if (!(weights[bin] > 0)) continue;
      last = bin;
      below = sum;
      sum += weights[bin];
      if (sum >= goal) break;
    }
    int const bits = shift(bins_log2);
    low += last << bits;
    high = std::min(high, low + ((Key(1) << bits) - 1));
  }
};

struct Candidate {
  Key key;
  Real weight;
};

/// Narrow all searches to one key each, that of candidates of some rank. Collective.
///
/// Each round sums weights in bins of what is left. A search ends early where all that is left of all ranks is one key
/// of one rank, which is summed with the zeros of the others, in halves that a Real holds.
void narrow(Communicator const& comm, std::vector<Search>& searches, std::vector<std::vector<Candidate>>& candidates) {
  int bins_log2 = 8;
  while (comm.ranks() > 1 && bins_log2 > 1 && searches.size() * ((1u << bins_log2) + 3) > most_sums) --bins_log2;
  std::size_t const bins = std::size_t(1) << bins_log2, row = bins + 3;
  while (std::any_of(searches.begin(), searches.end(), [](Search const& s) { return s.is_open(); })) {
    std::vector<Real> sums(searches.size() * row);
    for (std::size_t t = 0; t < searches.size(); ++t) {
      if (!searches[t].is_open() || candidates[t].empty()) continue;
      Real* const mine = sums.data() + t * row;
      Key const first = candidates[t].front().key;
      int const shift = searches[t].shift(bins_log2);
      bool one = true;
      for (auto const& [key, weight] : candidates[t]) {
        mine[(key - searches[t].low) >> shift] += weight;
        one = one && key == first;
      }
      mine[bins] = one ? 1 : 2;
      mine[bins + 1] = Real(first >> 32);
      mine[bins + 2] = Real(first & 0xFFFFFFFF);
    }
    comm.sum_each(sums);
    for (std::size_t t = 0; t < searches.size(); ++t) {
      auto& search = searches[t];
      if (!search.is_open()) continue;
      Real const* const of = sums.data() + t * row;
      if (search.total == 0) search.total = std::accumulate(of, of + bins, Real(0));
      if (!(search.total > 0))
        search.end_at(0);
      else if (of[bins] == 1)
        search.end_at(Key(of[bins + 1]) << 32 | Key(of[bins + 2]));
      else
        search.enter(of, bins_log2);
      auto& left = candidates[t];
      auto const outside = [&](Candidate const& c) { return c.key < search.low || c.key > search.high; };
      left.erase(std::remove_if(left.begin(), left.end(), outside), left.end());
    }
  }
}

}  // namespace

std::vector<Real> amplitude_quantiles(Communicator const& comm, BeamView const& beam, BeamParts const& parts,
                                      std::vector<AmplitudeFrame> const& frames, std::vector<Real> const& fractions) {
  std::size_t const kinds = frames.size() * amplitude_kinds;
  std::vector<Real> weights(kinds * first_bins);
  for_each_amplitude(beam, parts, frames, [&](std::size_t part, std::size_t kind, Key key, Real weight) {
    weights[(part * amplitude_kinds + kind) * first_bins + std::size_t(first_bin(key))] += weight;
  });
  std::vector<Search> searches;
  std::vector<std::vector<Candidate>> candidates(kinds * fractions.size());
  for (std::size_t t = 0; t < candidates.size(); ++t) {
    Real const* const own = weights.data() + t / fractions.size() * first_bins;
    searches.push_back({0, first_bins - 1, fractions[t % fractions.size()]});
    for (int bin = 0; bin < first_bins; ++bin)
      if (own[bin] > 0) candidates[t].push_back({Key(bin), own[bin]});
  }
  narrow(comm, searches, candidates);

  std::vector<std::uint32_t> wanted(weights.size());  // a bit for each fraction whose search ends in a first bin
  for (std::size_t t = 0; t < searches.size(); ++t) {
    auto& search = searches[t];
    candidates[t].clear();
    if (!(search.total > 0)) continue;
    Key const bin = search.low;
    wanted[t / fractions.size() * first_bins + bin] |= std::uint32_t(1) << t % fractions.size();
    search.low = bin > 0 ? first_key + (bin << first_shift) : 0;
    search.high = bin < first_bins - 1 ? first_key + ((bin + 1) << first_shift) - 1 : last_key;
  }
  for_each_amplitude(beam, parts, frames, [&](std::size_t part, std::size_t kind, Key key, Real weight) {
    std::size_t const at = part * amplitude_kinds + kind;
    for_each_bit(wanted[at * first_bins + std::size_t(first_bin(key))], [&](int k) {
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
