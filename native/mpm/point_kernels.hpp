// Functions of a point, as in fem/at_points.hpp: of slopes in an element, a vector for each of some points. What they
// need is kept in blocks, all weights and scales of coordinates in it.
#pragma once

#include "fem/operator_of.hpp"

namespace amrpic::mpm {

using fem::AtPoint;
using fem::of_block;
using fem::V;
using fem::VectorOf;
template <class Vector = V>
using Matrix = std::array<std::array<Vector, 3>, 3>;

inline constexpr std::size_t symmetric[3][3] = {{0, 5, 4}, {5, 1, 3}, {4, 3, 2}};  ///< 11, 22, 33, 23, 31, 12

template <class F>
inline void for_each_entry(F&& f) {
#pragma GCC unroll 3
  for (std::size_t i = 0; i < 3; ++i)
#pragma GCC unroll 3
    for (std::size_t j = 0; j < 3; ++j) f(i, j);
}

/// a b
template <class A, class B>
inline auto product(A const& a, B const& b) {
  Matrix<std::decay_t<decltype(b[0][0])>> out;
  for_each_entry(
      [&](std::size_t i, std::size_t j) { out[i][j] = a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j]; });
  return out;
}

/// out = a b'
template <class Vector, class Out>
inline void write_transposed_product(Matrix<Vector> const& a, Matrix<Vector> const& b, Out& out) {
  for_each_entry(
      [&](std::size_t i, std::size_t j) { out[i][j] = a[i][0] * b[j][0] + a[i][1] * b[j][1] + a[i][2] * b[j][2]; });
}

/// Blocks of `width` values of points, each as the sum of two numbers in single precision: the first one alone is what
/// a pair of blocks takes, and both are exact to 48 bits, in no more memory than one in double precision.
class Blocks {
 public:
  Blocks(fem::Points const& points, int width)
      : width_(width), high_(std::make_shared<Floats>(std::size_t(points.blocks() * width * native_lane_count), 0)) {
    low_ = std::make_shared<Floats>(high_->size(), 0);
  }

  /// The values of a point, a lane of a block.
  void write(Real const* values, std::int64_t block, int lane) {
    for (int number = 0; number < width_; ++number) {
      std::size_t const to = place(block, std::size_t(number)) + std::size_t(lane);
      (*high_)[to] = float(values[number]);
      (*low_)[to] = float(values[number] - Real((*high_)[to]));
    }
  }

  V operator()(std::int64_t block, std::size_t number) const {
    std::size_t const at = place(block, number);
    return __builtin_convertvector(load<HalfFloats>(high_->data() + at), V) +
           __builtin_convertvector(load<HalfFloats>(low_->data() + at), V);
  }
  NativeFloats operator()(fem::BlockPair const& pair, std::size_t number) const {
    float const* const high = high_->data();
    return joined(load<HalfFloats>(high + place(pair.first, number)),
                  load<HalfFloats>(high + place(pair.second, number)));
  }
  template <class Block>
  auto matrix(Block const& block, std::size_t number) const {
    Matrix<VectorOf<Block>> out;
    for_each_entry([&](std::size_t i, std::size_t j) { out[i][j] = (*this)(block, number + 3 * i + j); });
    return out;
  }
  template <class Block>
  auto symmetric_matrix(Block const& block, std::size_t number) const {
    Matrix<VectorOf<Block>> out;
    for_each_entry([&](std::size_t i, std::size_t j) { out[i][j] = (*this)(block, number + symmetric[i][j]); });
    return out;
  }

 private:
  using Floats = std::vector<float, fem::BlockAllocator<float>>;

  std::size_t place(std::int64_t block, std::size_t number) const {
    return (std::size_t(block) * std::size_t(width_) + number) * native_lane_count;
  }

  int width_;
  std::shared_ptr<Floats> high_, low_;
};

/// A point among blocks of points.
struct Place {
  std::int64_t block;
  int lane;
  std::size_t point;
};

/// Call f(place) for the points of a block.
template <class F>
void for_each_place(fem::Points const& points, std::int64_t block, F&& f) {
  std::int64_t const first = points.first_point(block);
  int const count = int(points.first_point(block + 1) - first);
  for (int lane = 0; lane < count; ++lane) f(Place{block, lane, std::size_t(first + lane)});
}

/// What all functions `D` of slopes have in common.
template <class D>
struct OfSlopes {
  static constexpr bool reads = true, writes = true, values = false, slopes = true, rigid_modes = true,
                        in_single = true;

  template <int P, int C>
  fem::SlopesAtGauss<P, C> at_gauss(fem::Points const& points) const {
    return {points, fem::PointFunction<C>::of(static_cast<D const&>(*this))};
  }
};

/// In the current configuration: A = S (grad x)^-1 with the scales S of the element's coordinates, stress, moduli.
/// Their rule is c : e = a tr(e) 1 + b e, less d (dev(stress) tr(e) + (dev(stress) : e) 1) if there is `damage`.
template <bool damage>
struct CurrentIsotropic : OfSlopes<CurrentIsotropic<damage>> {
  static constexpr int width = 9 + 6 + (damage ? 3 : 2);
  Blocks state;

  explicit CurrentIsotropic(Blocks state) : state(std::move(state)) {}
  template <class Block, class Vector>
  void operator()(Block const& block, AtPoint<3, Vector>& at) const {
    Matrix<Vector> const a = state.matrix(block, 0), stress = state.symmetric_matrix(block, 9);
    Matrix<Vector> const h = product(at.slope, a);
    Vector const of_trace = state(block, 15), half = state(block, 16);  // half of b
    Vector const trace = h[0][0] + h[1][1] + h[2][2];
    Vector along = of_trace * trace;
    Matrix<Vector> x = product(h, stress);
    for_each_entry([&](std::size_t i, std::size_t j) { x[i][j] += half * (h[i][j] + h[j][i]); });
    if constexpr (damage) {
      Vector const d = state(block, 17), mean = (stress[0][0] + stress[1][1] + stress[2][2]) * NumberOf<Vector>(1. / 3);
      Vector work = -mean * trace;
      for_each_entry([&](std::size_t i, std::size_t j) { work += stress[i][j] * h[i][j]; });
      Vector const by = d * trace;
      for_each_entry([&](std::size_t i, std::size_t j) { x[i][j] -= by * stress[i][j]; });
      along += by * mean - d * work;
    }
    for (std::size_t i = 0; i < 3; ++i) x[i][i] += along;
    write_transposed_product(x, a, at.slope);
  }
};

/// The same with any 21 moduli between the six strains 11, 22, 33, 23, 31, 12, upper triangle row by row.
struct CurrentGeneral : OfSlopes<CurrentGeneral> {
  static constexpr int width = 9 + 6 + 21;
  Blocks state;

  explicit CurrentGeneral(Blocks state) : state(std::move(state)) {}
  template <class Block, class Vector>
  void operator()(Block const& block, AtPoint<3, Vector>& at) const {
    Matrix<Vector> const a = state.matrix(block, 0);
    Matrix<Vector> const h = product(at.slope, a);
    Vector const e[6] = {h[0][0], h[1][1], h[2][2], h[1][2] + h[2][1], h[2][0] + h[0][2], h[0][1] + h[1][0]};
    Vector s[6] = {};
    std::size_t number = 15;
#pragma GCC unroll 6
    for (std::size_t i = 0; i < 6; ++i) {
      Vector const on_diagonal = state(block, number++);
      s[i] += on_diagonal * e[i];
#pragma GCC unroll 6
      for (std::size_t j = i + 1; j < 6; ++j) {
        Vector const modulus = state(block, number++);
        s[i] += modulus * e[j];
        s[j] += modulus * e[i];
      }
    }
    Matrix<Vector> x = product(h, state.symmetric_matrix(block, 9));
    for_each_entry([&](std::size_t i, std::size_t j) { x[i][j] += s[symmetric[i][j]]; });
    write_transposed_product(x, a, at.slope);
  }
};

/// In the initial configuration, neo-Hookean: A as above, mu S F~ F~' S, mu - lambda ln J, lambda.
struct InitialNeoHookean : OfSlopes<InitialNeoHookean> {
  static constexpr int width = 9 + 6 + 2;
  Blocks state;

  explicit InitialNeoHookean(Blocks state) : state(std::move(state)) {}
  template <class Block, class Vector>
  void operator()(Block const& block, AtPoint<3, Vector>& at) const {
    Matrix<Vector> const a = state.matrix(block, 0);
    Matrix<Vector> const ag = product(a, at.slope);
    Matrix<Vector> const aga = product(ag, a);
    Vector const back = state(block, 15), along = state(block, 16) * (ag[0][0] + ag[1][1] + ag[2][2]);
    Matrix<Vector> x = product(at.slope, state.symmetric_matrix(block, 9));
    for_each_entry(
        [&](std::size_t i, std::size_t j) { at.slope[i][j] = x[i][j] + back * aga[j][i] + along * a[j][i]; });
  }
};

/// A mass and a Poisson operator with factors of each point: of the value, and of slopes along each axis.
struct Damage {
  static constexpr bool reads = true, writes = true, values = true, slopes = true, rigid_modes = false,
                        in_single = false;
  static constexpr int width = 4;
  Blocks state;

  explicit Damage(Blocks state) : state(std::move(state)) {}
  void operator()(std::int64_t block, AtPoint<1>& at) const {
    at.value[0] *= state(block, 0);
    for (std::size_t d = 0; d < 3; ++d) at.slope[0][d] *= state(block, 1 + d);
  }
  template <int P, int C>
  fem::AtPoints<P, C, Damage> at_gauss(fem::Points const& points) const {
    return {points, *this};
  }
};

}  // namespace amrpic::mpm
