// What is done to one row of cells along x, on whole vectors. Places past the row's end, up to its pitch, take part;
// no cell reads their values.
#pragma once

#include <array>

#include "base/fetch.hpp"
#include "base/lanes.hpp"
#include "cycle/rows.hpp"
#include "stencil/intergrid.hpp"

namespace amrpic::cycle {

/// How far ahead the first stage of a pass prefetches.
constexpr std::ptrdiff_t ahead = page<float> / 2;

/// Call f(lanes, isotropic) with both as constants.
template <class F>
void with_kind(int lanes, bool isotropic, F&& f) {
  using std::integral_constant;
  auto choose = [&](auto n) {
    isotropic ? f(n, integral_constant<bool, true>()) : f(n, integral_constant<bool, false>());
  };
  lanes == widest ? choose(integral_constant<int, widest>()) : choose(integral_constant<int, narrowest>());
}

/// Call f(v, e, sum) for each vector of a row: its values, and the weighted sum over its neighbours.
template <int N, bool isotropic, class F>
inline void for_each_vector(CorrectionRow const& row, std::array<float, 3> const& weight, F&& f) {
  using L = FloatLanes<N>;
  typename L::Type before = all<N>(row.left), here = load<N>(row.here);
  auto act = [&](int v, typename L::Type const& right) {
    typename L::Type const x = L::from_left(before, here) + right;
    typename L::Type const y = load<N>(row.beside[0] + v * N) + load<N>(row.beside[1] + v * N);
    typename L::Type const z = load<N>(row.beside[2] + v * N) + load<N>(row.beside[3] + v * N);
    if constexpr (isotropic)
      f(v, here, x + y + z);
    else
      f(v, here, weighted_sum(weight, x, y, z));
  };
  int const end = row.vectors - 1;
  for (int v = 0; v < end; ++v) {
    typename L::Type const after = load<N>(row.here + (v + 1) * N);
    act(v, L::from_right(here, after));
    before = here;
    here = after;
  }
  typename L::Type const after = all<N>(row.right);
  act(end, L::numbers == row.last ? after : L::from_right(here, after));
}

/// One colour of a row relaxed, at the places of that `parity`: e = keep e + step (sum - r); `step` is zero in the
/// other colour.
template <int N, bool isotropic>
inline void relax(CorrectionRow const& row, std::array<float, 3> const& weight, float const* r, float const* step,
                  float keep, int parity) {
  using L = FloatLanes<N>;
  typename L::Type const keeps = (L::numbers & 1) == parity ? all<N>(keep) : all<N>(1);
  for_each_vector<N, isotropic>(row, weight, [&](int v, auto const& e, auto const& sum) {
    store(row.here + v * N, relaxed(keeps, e, load<N>(step + v * N), sum, load<N>(r + v * N)));
  });
}

/// The same from zero: the other colour is set to zero.
template <int N>
inline void relax_from_zero(float* e, float const* r, float const* step, int vectors) {
  for (int v = 0; v < vectors; ++v) {
    fetch<Use::read>(r + v * N + ahead, N);
    fetch<Use::write>(e + v * N + ahead, N);
    store(e + v * N, relaxed_from_zero(load<N>(step + v * N), load<N>(r + v * N)));
  }
}

/// What of r is left: r - (sum - d e).
template <int N, bool isotropic>
inline void residual(CorrectionRow const& row, std::array<float, 3> const& weight, float const* r,
                     float const* diagonal, float* out) {
  for_each_vector<N, isotropic>(row, weight, [&](int v, auto const& e, auto const& sum) {
    store(out + v * N, remaining(load<N>(r + v * N), sum, load<N>(diagonal + v * N), e));
  });
}

inline void residual(DifferenceRow const& row, std::array<float, 3> const& weight, float const* r, float const* held,
                     float* out) {
  auto const find = [&](int i) { out[i] = row.remaining(weight, r[i], held[i], i); };
  find(0);
  for (int i = 1; i + 1 < row.cells; ++i) find(i);  // the compiler sees that these are not at an end
  if (row.cells > 1) find(row.cells - 1);
}

/// Set `n` numbers to `values`, or add these; n at most N.
template <int N>
inline void put(float* to, typename FloatLanes<N>::Type const& values, std::ptrdiff_t n, bool set) {
  if (n >= N) return store(to, set ? values : load<N>(to) + values);
  for (std::ptrdiff_t i = 0; i < n; ++i) to[i] = set ? values[i] : to[i] + values[i];
}

/// Set a coarse row of `cells` to `weight` times the sum of each one's children in a fine row (one or two), or add it.
template <int N>
inline void restrict_row(float const* fine, int cells, int ratio, float weight, bool set, float* coarse) {
  using L = FloatLanes<N>;
  for (std::ptrdiff_t place = 0; place < cells; place += N) {
    float const* const children = fine + place * ratio;
    if (ratio == 1) {
      put<N>(coarse + place, weight * load<N>(children), cells - place, set);
    } else {
      typename L::Type const a = load<N>(children), b = load<N>(children + N);
      put<N>(coarse + place, weight * (L::even(a, b) + L::odd(a, b)), cells - place, set);
    }
  }
}

/// Set a fine row of `vectors` to the trilinear interpolation between coarse rows, or add it. The sweeps behind read r
/// of the same row.
template <int N>
inline void prolong_row(CoarseRows const& coarse, int ratio, int vectors, bool set, float const* r, float* fine) {
  using L = FloatLanes<N>;
  auto mean = [&](int place) {
    typename L::Type sum = coarse.weight[0] * load<N>(coarse.row[0] + place);
    for (int c = 1; c < coarse.count; ++c) sum += coarse.weight[c] * load<N>(coarse.row[c] + place);
    return sum;
  };
  auto put = [&](int v, typename L::Type const& values) {
    fetch<Use::write>(fine + v * N + ahead, N);
    fetch<Use::read>(r + v * N + ahead, N);
    store(fine + v * N, set ? values : load<N>(fine + v * N) + values);
  };
  if (ratio == 1) {
    for (int v = 0; v < vectors; ++v) put(v, mean(v * N));
    return;
  }
  for (int v = 0; v < vectors; v += 2) {
    int const place = v / 2 * N;
    constexpr float near = prolongation::near, far = prolongation::far;
    typename L::Type const here = near * mean(place);
    typename L::Type const lower = here + far * mean(place - 1), upper = here + far * mean(place + 1);
    put(v, L::interleave_low(lower, upper));
    if (v + 1 < vectors) put(v + 1, L::interleave_high(lower, upper));
  }
}

}  // namespace amrpic::cycle
