// Finite volumes of fourth order, on means of cells: the flux through a face from the four cells in line with it, which
// is the mean over the face as it stands, without tangential terms (Barad and Colella, 2005).
#pragma once

#include <array>
#include <cstddef>
#include <utility>
#include <vector>

#include "base/fused.hpp"
#include "stencil/equation.hpp"
#include "stencil/laplacian.hpp"
#include "stencil/wall_ghost.hpp"

namespace amrpic::fourth_order {

constexpr int ghost_layers = 2;

/// The difference across a face, which is h times the mean derivative, of the means of the cells in line with it.
template <class Value>
inline Value difference(Value const& below_2, Value const& below_1, Value const& above_1, Value const& above_2) {
  return Real(15.0 / 12) * (above_1 - below_1) - Real(1.0 / 12) * (above_2 - below_2);
}

/// What the cells one and two away along an axis add to h^2 times the second derivative: sums of either pair.
constexpr Real near_pair = 16.0 / 12, far_pair = -1.0 / 12, own_cell = -30.0 / 12;
template <class Value>
inline Value across(Value const& near, Value const& far) {
  return fused(near_pair, near, Value(far_pair * far));
}

/// -L phi 's weight of the cell itself.
inline Real diagonal(Equation const& l) { return -own_cell * (l.weight[0] + l.weight[1] + l.weight[2]) + l.shift; }

/// L phi of a cell's mean and, along each axis, what the cells in line with it add.
inline Real laplacian(Equation const& l, Real c, Real x, Real y, Real z) {
  return fused(-diagonal(l), c, weighted_sum(l.weight, x, y, z));
}

/// The mean over a cell of -h d phi/dx along an axis: the difference of the face means, which are
/// (-1, 7, 7, -1)/12 of the cells in line.
template <class Value>
inline Value mean_field(Value const& below_2, Value const& below_1, Value const& above_1, Value const& above_2) {
  return Real(8.0 / 12) * (below_1 - above_1) - Real(1.0 / 12) * (below_2 - above_2);
}

/// A mean less the value at the centre, or the other way round: a 24th of the second differences along the axes.
constexpr Real mean_less_point = 1.0 / 24;

/// What one axis adds to the truncation error of L: of a second derivative's weight 1 / h^2 and the sixth difference.
inline Real truncation_error(Real weight, Real sixth_difference) { return -weight * sixth_difference / 90; }

// ---- polynomials through means ----

/// What is known of a polynomial along a line, or asked of it: its mean over [from, to], or, where these are equal, its
/// value there, or its derivative.
struct Functional {
  Real from, to;
  bool is_slope = false;

  /// Of the power x^k.
  Real of_power(int k) const {
    if (is_slope) return k == 0 ? 0 : k * power(from, k - 1);
    if (from == to) return power(from, k);
    return (power(to, k + 1) - power(from, k + 1)) / ((k + 1) * (to - from));
  }

 private:
  static Real power(Real x, int k) {
    Real out = 1;
    for (; k > 0; --k) out *= x;
    return out;
  }
};
inline Functional mean_over(Real from, Real to) { return {from, to}; }
inline Functional value_at(Real x) { return {x, x}; }
inline Functional slope_at(Real x) { return {x, x, true}; }

/// The weights of what is known in what is asked of the polynomial of least degree, by elimination.
inline std::vector<Real> weights_of(std::vector<Functional> const& known, Functional const& asked) {
  std::size_t const n = known.size();
  std::vector<std::vector<Real>> a(n, std::vector<Real>(n + 1));
  for (std::size_t k = 0; k < n; ++k) {
    for (std::size_t c = 0; c < n; ++c) a[k][c] = known[c].of_power(int(k));
    a[k][n] = asked.of_power(int(k));
  }
  for (std::size_t k = 0; k < n; ++k) {
    std::size_t pivot = k;
    for (std::size_t r = k + 1; r < n; ++r)
      if (a[r][k] * a[r][k] > a[pivot][k] * a[pivot][k]) pivot = r;
    std::swap(a[k], a[pivot]);
    for (std::size_t r = 0; r < n; ++r) {
      if (r == k) continue;
      Real const factor = a[r][k] / a[k][k];
      for (std::size_t c = k; c <= n; ++c) a[r][c] -= factor * a[k][c];
    }
  }
  std::vector<Real> out(n);
  for (std::size_t k = 0; k < n; ++k) out[k] = a[k][n] / a[k][k];
  return out;
}

// ---- walls ----

constexpr int wall_cells = 4;  ///< that a ghost behind a wall takes at most

/// How many it takes of a kind of wall. With four behind a Dirichlet wall the residual would have stiffer modes there
/// than any ghost of the cycle makes, and a solve would take two cycles more.
constexpr int cells_at_wall(Boundary kind) { return kind == Boundary::dirichlet ? 3 : wall_cells; }

/// The means of the two ghost cells behind a wall, from the mean over the wall's face of its datum and the means of the
/// first cells inside: the polynomial through all of these.
struct WallGhosts {
  struct Layer {
    std::array<Real, wall_cells> cell{};
    Real datum = 0;
    Real operator()(std::array<Real, wall_cells> const& inside, Real given) const {
      Real sum = datum * given;
      for (std::size_t n = 0; n < wall_cells; ++n) sum += cell[n] * inside[n];
      return sum;
    }
  };
  std::array<Layer, ghost_layers> layer;
};

/// Those of a kind of wall, of a polynomial through `cells` cells; the datum of a Neumann wall is the outward
/// derivative. Behind open walls both means are data themselves.
inline WallGhosts make_wall_ghosts(Boundary kind, Real spacing, int cells) {
  WallGhosts out;
  if (kind != Boundary::dirichlet && kind != Boundary::neumann) return out;
  std::vector<Functional> known;
  for (int n = 0; n < cells; ++n) known.push_back(mean_over(n, n + 1));
  known.push_back(kind == Boundary::dirichlet ? value_at(0) : slope_at(0));
  for (int n = 0; n < ghost_layers; ++n) {
    auto const weights = weights_of(known, mean_over(-n - 1, -n));
    auto& layer = out.layer[std::size_t(n)];
    for (int c = 0; c < cells; ++c) layer.cell[std::size_t(c)] = weights[std::size_t(c)];
    layer.datum = kind == Boundary::dirichlet ? weights.back() : -spacing * weights.back();
  }
  return out;
}

/// Of cells beyond an end of a line, the means by those of so many cells before it.
constexpr int extrapolation_cells = 5;
using Extrapolation = std::array<std::array<Real, extrapolation_cells>, ghost_layers>;
inline Extrapolation make_extrapolation() {
  Extrapolation out;
  std::vector<Functional> known;
  for (int n = 0; n < extrapolation_cells; ++n) known.push_back(mean_over(n, n + 1));
  for (int n = 0; n < ghost_layers; ++n) {
    auto const weights = weights_of(known, mean_over(-n - 1, -n));
    for (std::size_t c = 0; c < extrapolation_cells; ++c) out[std::size_t(n)][c] = weights[c];
  }
  return out;
}

// ---- coarse-fine faces ----

/// Along the normal, in fine cell widths: coarse means over [-2, 0] and [-4, -2], already over the fine cells' faces,
/// and fine ones over [0, 1], [1, 2], [2, 3].
constexpr int fine_cells = 3, coarse_cells = 2;
struct InterfaceGhosts {
  struct Layer {
    std::array<Real, coarse_cells> coarse{};
    std::array<Real, fine_cells> fine{};
  };
  std::array<Layer, ghost_layers> layer;
};

/// The means of the two fine ghosts in front of coarse cells, of so many coarse and fine means.
inline InterfaceGhosts make_interface_ghosts(int coarse, int fine) {
  InterfaceGhosts out;
  std::vector<Functional> known;
  for (int n = 0; n < coarse; ++n) known.push_back(mean_over(-2 * n - 2, -2 * n));
  for (int n = 0; n < fine; ++n) known.push_back(mean_over(n, n + 1));
  for (int n = 0; n < ghost_layers; ++n) {
    auto const weights = weights_of(known, mean_over(-n - 1, -n));
    auto& layer = out.layer[std::size_t(n)];
    for (int c = 0; c < coarse; ++c) layer.coarse[std::size_t(c)] = weights[std::size_t(c)];
    for (int f = 0; f < fine; ++f) layer.fine[std::size_t(f)] = weights[std::size_t(coarse + f)];
  }
  return out;
}

/// In the plane of the coarse cells: the block of `size` x `size` means that those over the four quarters of a cell are
/// taken from; its first cell lies at (u, v) from that one.
struct MeansBlock {
  static constexpr int most = 5, reach = 4;  ///< largest size, and how far from the cell a block may lie
  signed char u = 0, v = 0, size = 0;        ///< size 0: none is usable
  bool is_central() const { return size == most && u == -most / 2 && v == -most / 2; }
};

/// The largest block that holds the cell and only usable ones, and of these the one with its middle nearest to the
/// cell: usable(u, v, size) says so of the block with that first cell.
template <class Usable>
MeansBlock best_block(Usable&& usable) {
  constexpr signed char middle = -MeansBlock::most / 2;
  if (usable(middle, middle, MeansBlock::most)) return {middle, middle, MeansBlock::most};
  for (int size = MeansBlock::most; size > 0; --size) {
    MeansBlock best;
    int least = 1 << 20;
    for (int v = 1 - size; v <= 0; ++v)
      for (int u = 1 - size; u <= 0; ++u) {
        int const du = 2 * u + size - 1, dv = 2 * v + size - 1, far = du * du + dv * dv;
        if (far < least && usable(u, v, size)) {
          best = {static_cast<signed char>(u), static_cast<signed char>(v), static_cast<signed char>(size)};
          least = far;
        }
      }
    if (best.size > 0) return best;
  }
  return {};
}

/// Weights of `size` coarse means, the first of which lies `first` cells from the middle one, in the means over the
/// middle one's lower and upper half.
inline std::array<std::array<Real, MeansBlock::most>, 2> make_half_weights(int first, int size) {
  std::array<std::array<Real, MeansBlock::most>, 2> out{};
  std::vector<Functional> known;
  for (int n = 0; n < size; ++n) known.push_back(mean_over(first + n - 0.5, first + n + 0.5));
  for (int half = 0; half < 2; ++half) {
    auto const weights = weights_of(known, mean_over(0.5 * half - 0.5, 0.5 * half));
    for (int n = 0; n < size; ++n) out[std::size_t(half)][std::size_t(n)] = weights[std::size_t(n)];
  }
  return out;
}

}  // namespace amrpic::fourth_order
