#include "fem/element_matrix.hpp"

#include "fem/degrees.hpp"

namespace amrpic::fem {

template <int P, int C>
void ElementMatrix<P, C>::read(std::int64_t block, std::size_t number) {
  auto const here = rows_at_block(points_, block, [&](V const& x) { return of_nodes(x); });
  Real* const out = &slopes_[number * 3 * native_lane_count * padded];
  for (int k = 0, n = 0; k < P; ++k)
    for (int j = 0; j < P; ++j)
      for (int i = 0; i < P; ++i, ++n) {
        V const slope[3] = {here[0].slope[i] * here[1].value[j] * here[2].value[k],
                            here[0].value[i] * here[1].slope[j] * here[2].value[k],
                            here[0].value[i] * here[1].value[j] * here[2].slope[k]};
        for (int l = 0; l < native_lane_count; ++l)
          for (int e = 0; e < 3; ++e) out[(3 * l + e) * padded + n] = slope[e][l];
      }
  of_units_.resize((number + 1) * std::size_t(9 * C * C));
  V* to = &of_units_[number * std::size_t(9 * C * C)];
  for (int b = 0; b < C; ++b)
    for (std::size_t e = 0; e < 3; ++e) {
      AtPoint<C> unit{};
      unit.slope[b][e] = V{} + Real(1);
      d_(block, unit);
      for (int a = 0; a < C; ++a)
        for (std::size_t f = 0; f < 3; ++f) *to++ = unit.slope[a][f];
    }
}

template <int P, int C>
Rows<P, V> ElementMatrix<P, C>::of_nodes(V const& x) const {
  auto const chebyshev = chebyshev_rows<P>(x);
  Rows<P, V> out{};
  for (int i = 0; i < P; ++i)
    for (int n = 0; n < P; ++n) {
      out.value[i] += of_node_[i][n] * chebyshev.value[n];
      out.slope[i] += of_node_[i][n] * chebyshev.slope[n];
    }
  return out;
}

template <int P, int C>
void ElementMatrix<P, C>::make(std::size_t blocks, int a, int b) {
  for (std::size_t block = 0; block < blocks; ++block) {
    V const* const units = &of_units_[block * std::size_t(9 * C * C)];
    for (int l = 0; l < native_lane_count; ++l) {
      std::size_t const row = (block * native_lane_count + std::size_t(l)) * 3;
      Real const* const in = &slopes_[row * padded];
      for (int f = 0; f < 3; ++f) {
        Real by[3];
        for (int e = 0; e < 3; ++e) by[e] = units[((b * 3 + e) * C + a) * 3 + f][l];
        Real* const out = &made_[(row + std::size_t(f)) * padded];
        for (int n = 0; n < padded; ++n) out[n] = by[0] * in[n] + by[1] * in[padded + n] + by[2] * in[2 * padded + n];
      }
    }
  }
}

template <int P, int C>
void ElementMatrix<P, C>::multiply(std::size_t rows, int a, int b, int first, int vector, Real* matrix) const {
  V sums[rows_at_once][vectors_at_once] = {};
  Real const *g = &slopes_[std::size_t(first)], *h = &made_[std::size_t(vector * native_lane_count)];
  for (std::size_t row = 0; row < rows; ++row, g += padded, h += padded) {
    V column[vectors_at_once];
#pragma GCC unroll 4
    for (int v = 0; v < vectors_at_once; ++v) column[v] = load<V>(h + v * native_lane_count);
#pragma GCC unroll 5
    for (int r = 0; r < rows_at_once; ++r)
#pragma GCC unroll 4
      for (int v = 0; v < vectors_at_once; ++v) sums[r][v] += g[r] * column[v];
  }
  constexpr std::size_t all = C * nodes;
  for (int r = 0; r < rows_at_once; ++r)
    for (int v = 0; v < vectors_at_once; ++v)
      for (int l = 0; l < native_lane_count; ++l) {
        int const n = (vector + v) * native_lane_count + l;
        if (n >= nodes) break;
        std::size_t const at = std::size_t(a * nodes + first + r), to = std::size_t(b * nodes + n);
        matrix[at * all + to] = matrix[to * all + at] = sums[r][v][l];
      }
}

template <int P, int C>
void ElementMatrix<P, C>::fill(LocalIndex element, std::vector<Real>& matrix) {
  std::int64_t const first = points_.first_block(element), last = points_.first_block(element + 1);
  std::size_t const rows = std::size_t(last - first) * 3 * native_lane_count;
  slopes_.assign(rows * padded, 0), made_.resize(rows * padded);
  for (std::int64_t block = first; block < last; ++block) read(block, std::size_t(block - first));
  matrix.resize(std::size_t(C * nodes) * std::size_t(C * nodes));
  for (int a = 0; a < C; ++a)
    for (int b = a; b < C; ++b) {
      make(std::size_t(last - first), a, b);
      for (int row = 0; row < nodes; row += rows_at_once)
        for (int v = 0; v < vectors; v += vectors_at_once) multiply(rows, a, b, row, v, matrix.data());
    }
}

#define AMRPIC_ELEMENT_MATRIX(P, C) template class ElementMatrix<P, C>;
AMRPIC_FOR_EACH_SHAPE(AMRPIC_ELEMENT_MATRIX)

}  // namespace amrpic::fem
