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
namespace {

constexpr std::size_t float_tile = 2 * tile;

/// The place of the number of the largest size.
std::size_t largest(float const* a, std::size_t count) {
  NativeFloats sizes{}, places{};
  for (std::size_t n = 0; n < count; n += float_tile) {
    auto const here = load<NativeFloats>(a + n), size = here < 0 ? -here : here;
    places = size > sizes ? NativeFloats{} + float(n) : places;
    sizes = size > sizes ? size : sizes;
  }
  for (std::size_t l = 0; l < float_tile; ++l) places[l] += float(l);
  for (std::size_t half = float_tile / 2; half > 0; half /= 2)
    for (std::size_t l = 0; l < half; ++l) {
      bool const other = sizes[l + half] > sizes[l];
      places[l] = other ? places[l + half] : places[l];
      sizes[l] = other ? sizes[l + half] : sizes[l];
    }
  return std::size_t(places[0]);
}

}  // namespace

// By elimination, a tile of rows at a time; each row takes the column of its largest entry.
std::vector<float> solution_in_floats(Real const* matrix, std::vector<Real> const& b) {
  constexpr float independent = 1e-3f;
  std::size_t const size = b.size(), from_stride = padded(size);
  std::size_t const behind = (size + float_tile - 1) / float_tile * float_tile, stride = behind + float_tile;
  std::vector<float, CacheLines<float>> left(padded(size) * stride, 0);  // right-hand sides are behind columns
  auto const row = [data = left.data(), stride](std::size_t i) { return data + i * stride; };
  for (std::size_t i = 0; i < size; ++i) {
    std::copy_n(matrix + i * from_stride, size, row(i));
    row(i)[behind] = float(b[i]);
  }
  std::vector<std::size_t> own(size);  // the column of each row
  for (std::size_t first = 0; first < size; first += tile) {
    std::size_t const last = std::min(first + tile, size);
    for (std::size_t k = first; k < last; ++k) {
      own[k] = largest(row(k), behind);
      if (std::abs(row(k)[own[k]]) < independent) return {};
      float const one = 1 / row(k)[own[k]];
      float by[tile];
      for (std::size_t l = 0; l < tile; ++l) by[l] = row(first + l)[own[k]];
      for (std::size_t n = 0; n < stride; n += float_tile) {
        auto const pivots = one * load<NativeFloats>(row(k) + n);
        for (std::size_t l = 0; l < tile; ++l) {
          auto const rest = load<NativeFloats>(row(first + l) + n) - by[l] * pivots;
          store(row(first + l) + n, first + l == k ? pivots : rest);
        }
      }
    }
    for (std::size_t i = last; i < size; ++i) {  // after whole tiles alone
      float by[tile];
      for (std::size_t l = 0; l < tile; ++l) by[l] = row(i)[own[first + l]];
      for (std::size_t n = 0; n < stride; n += float_tile) {
        auto rest = load<NativeFloats>(row(i) + n);
        for (std::size_t l = 0; l < tile; ++l) rest -= by[l] * load<NativeFloats>(row(first + l) + n);
        store(row(i) + n, rest);
      }
    }
  }
  std::vector<float> out(size);
  for (std::size_t first = padded(size); first > 0;) {
    first -= tile;
    std::size_t const last = std::min(first + tile, size);
    for (std::size_t k = first; k < last; ++k) out[own[k]] = row(k)[behind];
    for (std::size_t i = 0; i < first; ++i)
      for (std::size_t k = first; k < last; ++k) row(i)[behind] -= row(i)[own[k]] * out[own[k]];
  }
  return out;
}

}  // namespace amrpic::fem
