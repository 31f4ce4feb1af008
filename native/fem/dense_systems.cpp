#include "fem/dense_systems.hpp"

#include <cmath>
#include <utility>

namespace amrpic::fem {

Cholesky::Cholesky(Array& matrix, std::size_t size, Real shift)
    : u_(matrix.data()), size_(size), stride_(padded(size)), reciprocal_(size) {
  for (std::size_t first = 0; first < size; first += tile) {
    for (std::size_t n = first; n < stride_; n += tile) subtract_rows_before(first, n);
    for (std::size_t k = first; k < std::min(first + tile, size); ++k) {
      Real* const of_pivot = row(k);
      std::fill(of_pivot + first, of_pivot + k, Real(0));
      Real const pivot = of_pivot[k] + shift;
      Real const root = std::sqrt(std::max(pivot, shift)), by = 1 / root;
      for (std::size_t n = first; n < stride_; n += tile) store(of_pivot + n, by * load<NativeLanes>(of_pivot + n));
      of_pivot[k] = root, reciprocal_[k] = by;
      for (std::size_t i = k + 1; i < std::min(first + tile, size); ++i) subtract(row(i), of_pivot[i], of_pivot, i);
    }
  }
}

void Cholesky::solve(std::vector<Real>& b) const {
  for (std::size_t i = 0; i < size_; ++i) {
    Real const own = b[i] * reciprocal_[i];
    subtract(b.data(), own, row(i), i);
    b[i] = own;
  }
  for (std::size_t i = size_; i-- > 0;) {
    Real const own = std::exchange(b[i], 0);
    std::size_t const from = i / tile * tile;
    b[i] = (own - dot(row(i) + from, b.data() + from, stride_ - from)) * reciprocal_[i];
  }
}

/// a -= by b, from `first` on, and from up to a vector before.
void Cholesky::subtract(Real* a, Real by, Real const* b, std::size_t first) const {
  for (std::size_t n = first / tile * tile; n < stride_; n += tile)
    store(a + n, load<NativeLanes>(a + n) - by * load<NativeLanes>(b + n));
}
/// From a tile of rows, in the columns of one vector, what all rows before have to do with it.
void Cholesky::subtract_rows_before(std::size_t first, std::size_t column) const {
  NativeLanes left[tile];
  for (std::size_t r = 0; r < tile; ++r) left[r] = load<NativeLanes>(row(first + r) + column);
  for (std::size_t k = 0; k < first; ++k) {
    auto const there = load<NativeLanes>(row(k) + column);
    for (std::size_t r = 0; r < tile; ++r) left[r] -= row(k)[first + r] * there;
  }
  for (std::size_t r = 0; r < tile; ++r) store(row(first + r) + column, left[r]);
}

}  // namespace amrpic::fem
