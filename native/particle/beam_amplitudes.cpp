#include "particle/beam_amplitudes.hpp"

#include <limits>

namespace amrpic {

namespace {

typedef std::uint64_t Key;  // the bits of a number that is not negative: in the same order as such numbers

// First bins: each a fraction of an octave of the amplitude over the typical one; the outer ones hold all beyond.
constexpr int bins_per_octave_log2 = 5, octaves = 64, first_bins = octaves << bins_per_octave_log2;
constexpr int first_shift = 52 - bins_per_octave_log2;  // a double has 52 bits behind its exponent
constexpr Key first_key = Key(1023 - octaves / 2) << 52;
constexpr Key last_key = Key(0x7FF) << 52;                             // infinity
constexpr int later_bins_log2 = 8, later_bins = 1 << later_bins_log2;  // of each refinement
constexpr Real slack = 1e-12;                                          // of the weight: what sums may have lost

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
  Key low = 0, high = last_key;
  Real below = 0, goal = 0;

  int shift() const {
    Key const span = high - low;
    int const bits = span == 0 ? 0 : 64 - __builtin_clzll(span);
    return std::max(bits - later_bins_log2, 0);
  }

  /// The first bin at which the goal is reached; without any weight in them, the last one.
  int bin_of(Real const* weights, int bins) {
    int last = 0;
    Real sum = below;
    for (int bin = 0; bin < bins; ++bin) {
      if (!(weights[bin] > 0)) continue;
      last = bin;
      below = sum;
      sum += weights[bin];
      if (sum >= goal) break;
    }
    return last;
  }
};

struct Candidate {
  Key key;
  Real weight;
};

/// Narrow all searches to one number each. Collective.
void narrow(Communicator const& comm, std::vector<Search>& searches, std::vector<std::vector<Candidate>>& candidates) {
  auto const open = [](Search const& s) { return s.low < s.high; };
  while (std::any_of(searches.begin(), searches.end(), open)) {
    std::vector<Real> weights(searches.size() * later_bins);
    for (std::size_t t = 0; t < searches.size(); ++t)
      for (auto const& [key, weight] : candidates[t])
        weights[t * later_bins + ((key - searches[t].low) >> searches[t].shift())] += weight;
    comm.sum_each(weights);
    for (std::size_t t = 0; t < searches.size(); ++t) {
      auto& search = searches[t];
      if (!open(search)) continue;
      int const shift = search.shift();
      Key const bin = Key(search.bin_of(weights.data() + t * later_bins, later_bins));
      search.low += bin << shift;
      search.high = std::min(search.high, search.low + ((Key(1) << shift) - 1));
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
  std::vector<Real> weights(kinds * first_bins), largest(kinds, -1);
  for_each_amplitude(beam, parts, frames, [&](std::size_t part, std::size_t kind, Key key, Real weight) {
    std::size_t const at = part * amplitude_kinds + kind;
    weights[at * first_bins + std::size_t(first_bin(key))] += weight;
    largest[at] = std::max(largest[at], value_of(key));
  });
  comm.sum_each(weights);
  comm.largest_each(largest);

  std::vector<Search> searches(kinds * fractions.size());
  std::vector<std::uint32_t> wanted(weights.size());  // a bit for each fraction whose search ends in a first bin
  std::vector<Real> total(kinds);
  for (std::size_t at = 0; at < kinds; ++at) {
    Real const* const own = weights.data() + at * first_bins;
    for (int bin = 0; bin < first_bins; ++bin) total[at] += own[bin];
    for (std::size_t k = 0; k < fractions.size(); ++k) {
      std::size_t const t = at * fractions.size() + k;
      auto& search = searches[t];
      search.goal = fractions[k] * total[at] * (1 - slack);
      if (fractions[k] >= 1 || !(total[at] > 0)) {
        search.high = search.low = 0;
        continue;
      }
      int const bin = search.bin_of(own, first_bins);
      if (bin > 0) search.low = first_key + (Key(bin) << first_shift);
      if (bin < first_bins - 1) search.high = first_key + (Key(bin + 1) << first_shift) - 1;
      wanted[at * first_bins + std::size_t(bin)] |= std::uint32_t(1) << k;
    }
  }
  std::vector<std::vector<Candidate>> candidates(searches.size());
  for_each_amplitude(beam, parts, frames, [&](std::size_t part, std::size_t kind, Key key, Real weight) {
    std::size_t const at = part * amplitude_kinds + kind;
    for_each_bit(wanted[at * first_bins + std::size_t(first_bin(key))], [&](int k) {
      candidates[at * fractions.size() + std::size_t(k)].push_back({key, weight});
    });
  });
  narrow(comm, searches, candidates);

  std::vector<Real> out(searches.size());
  for (std::size_t t = 0; t < out.size(); ++t) {
    std::size_t const at = t / fractions.size(), kind = at % amplitude_kinds;
    Real const typical = frames[at / amplitude_kinds].typical[kind];
    Real const found = fractions[t % fractions.size()] >= 1 ? largest[at] : value_of(searches[t].low);
    Real const value = found * (typical == 0 ? 1 : typical);
    out[t] = total[at] > 0 ? (kind < 3 ? value : std::sqrt(value)) : std::numeric_limits<Real>::quiet_NaN();
  }
  return out;
}

}  // namespace amrpic
