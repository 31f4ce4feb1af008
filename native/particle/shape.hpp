// The clouds that particles are spread into. A shape gives, along one axis, the cells that a particle touches and the
// share of each; deposit and gather use the same shares, so that a particle does not push itself on a uniform grid.
// No shape reaches further than one cell beyond the particle's own, see `tile_reach`.
#pragma once

#include <array>
#include <utility>

#include "particle/lanes.hpp"

namespace amrpic {

/// Cells that a cloud touches along an axis, and the share of each; of one particle, or of eight.
template <int cells, class Number>
struct Shares {
  decltype(index_of(Number{})) first;  ///< leftmost cell touched
  std::array<Number, cells> share;     ///< sum to one
};

// Each shape: the shares of a particle at `x`, in cell widths from the lower face of cell 0.

/// All charge in the particle's own cell; the field it feels jumps from cell to cell.
struct NearestGridPoint {
  static constexpr int width = 1;
  template <class Number>
  static Shares<1, Number> at(Number const& x) {
    return {index_of(round_down(x)), {Number{} + 1}};
  }
};

/// Uniform cloud of one cell width (linear weighting).
struct CloudInCell {
  static constexpr int width = 2;
  template <class Number>
  static Shares<2, Number> at(Number const& x) {
    Number const s = x - Real(0.5);  // in cell widths from the centre of cell 0
    Number const left = round_down(s);
    Number const right_share = s - left;
    return {index_of(left), {1 - right_share, right_share}};
  }
};

/// Triangular cloud of two cell widths (quadratic weighting): the field it feels has a continuous slope.
struct TriangularCloud {
  static constexpr int width = 3;
  template <class Number>
  static Shares<3, Number> at(Number const& x) {
    Number const own = round_down(x);
    Number const s = x - own;  // in [0, 1), from the lower face of the particle's own cell
    Number const left = Real(0.5) * (1 - s) * (1 - s), right = Real(0.5) * s * s;
    return {index_of(own) - 1, {left, 1 - left - right, right}};
  }
};

enum class Shape { nearest_grid_point, cloud_in_cell, triangular };

/// Call f with the struct of a shape, so that kernels are compiled once per shape.
template <class F>
void with_shape(Shape shape, F&& f) {
  switch (shape) {
    case Shape::nearest_grid_point:
      return f(NearestGridPoint{});
    case Shape::cloud_in_cell:
      return f(CloudInCell{});
    case Shape::triangular:
      return f(TriangularCloud{});
  }
}

}  // namespace amrpic
