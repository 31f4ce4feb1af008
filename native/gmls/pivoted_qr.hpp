#pragma once

#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include "base/types.hpp"

namespace amrpic::gmls {

constexpr Real rank_tolerance = 1e-10;  ///< what is left of a column of unit length that depends on those before
constexpr Real zero_column = 1e-13;     ///< length over that of the longest column, of one that is rounding alone

/// The z of least norm with Qᵀ z = τ, for each of `targets` columns of τ: Q is (samples, unknowns) by rows, τ is
/// (unknowns, targets), z (samples, targets). With Q = U R by modified Gram-Schmidt with pivots, columns scaled to unit
/// length and orthogonalized twice, z = U v, where Rᵀ v = τ in as many equations as Q has rank: z lies in the range
/// of Q, so that its norm is the least. Whether the other equations hold is for the caller to see. Returns the rank.
inline int least_norm(int samples, int unknowns, int targets, Real const* q, Real const* tau, Real* z) {
  auto const m = std::size_t(samples), n = std::size_t(unknowns), count = std::size_t(targets);
  std::vector<Real> column(n * m), r(n * n, 0.0), length(n), v(n);
  std::vector<std::size_t> order(n);
  std::iota(order.begin(), order.end(), std::size_t(0));
  auto const norm = [&](std::size_t k) {
    Real const* const c = &column[k * m];
    return std::sqrt(std::inner_product(c, c + m, c, 0.0));
  };
  for (std::size_t k = 0; k < n; ++k) {
    for (std::size_t j = 0; j < m; ++j) column[k * m + j] = q[j * n + k];
    length[k] = norm(k);
  }
  Real const longest = *std::max_element(length.begin(), length.end());
  for (std::size_t k = 0; k < n; ++k) {
    Real const scale = length[k] > zero_column * longest ? 1 / length[k] : 0;
    for (std::size_t j = 0; j < m; ++j) column[k * m + j] *= scale;
  }
  std::fill(z, z + m * count, 0.0);
  std::size_t rank = 0;
  for (; rank < std::min(m, n); ++rank) {
    std::size_t best = rank;
    for (std::size_t k = rank; k < n; ++k)
      if (norm(k) > norm(best) * (1 + 1e-12)) best = k;
    if (!(norm(best) > rank_tolerance)) break;
    std::swap_ranges(&column[rank * m], &column[rank * m] + m, &column[best * m]);
    std::swap(length[rank], length[best]);
    std::swap(order[rank], order[best]);
    for (std::size_t row = 0; row < rank; ++row) std::swap(r[row * n + rank], r[row * n + best]);
    Real* const u = &column[rank * m];
    auto const remove = [&](std::size_t from, std::size_t to) {  // the part of column `to` along column `from`
      Real* const c = &column[to * m];
      Real const along = std::inner_product(c, c + m, &column[from * m], 0.0);
      for (std::size_t j = 0; j < m; ++j) c[j] -= along * column[from * m + j];
      r[from * n + to] += along;
    };
    for (std::size_t k = 0; k < rank; ++k) remove(k, rank);
    r[rank * n + rank] = norm(rank);
    for (std::size_t j = 0; j < m; ++j) u[j] /= r[rank * n + rank];
    for (std::size_t k = rank + 1; k < n; ++k) remove(rank, k);
  }
  for (std::size_t t = 0; t < count; ++t)
    for (std::size_t k = 0; k < rank; ++k) {
      v[k] = tau[order[k] * count + t] / length[k];
      for (std::size_t i = 0; i < k; ++i) v[k] -= r[i * n + k] * v[i];
      v[k] /= r[k * n + k];
      for (std::size_t j = 0; j < m; ++j) z[j * count + t] += column[k * m + j] * v[k];
    }
  return int(rank);
}

}  // namespace amrpic::gmls
