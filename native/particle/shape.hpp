// The clouds that particles are spread into. A shape gives, along one axis, the cells that a particle touches and the
// share of each; deposit and gather use the same shares, so that a particle does not push itself on a uniform grid.
// No shape reaches further than one cell beyond the particle's own, see `tile_reach`.
#pragma once

#include <array>
#include <utility>

#include "particle/lane_groups.hpp"

namespace amrpic {

/// Cells that clouds touch along an axis, and the share of each.
template <int cells>
struct Shares {
  Lanes first;                     ///< leftmost cell touched, a whole number
  std::array<Lanes, cells> share;  ///< sum to one
};

// Each shape: the shares of particles at `x`, in cell widths from the lower face of cell 0.

/// All charge in the particle's own cell; the field it feels jumps from cell to cell.
struct NearestGridPoint {
  static constexpr int width = 1;
  static Shares<1> at(Lanes const& x) { return {round_down(x), {Lanes{} + 1}}; }
};

/// Uniform cloud of one cell width (linear weighting).
struct CloudInCell {
  static constexpr int width = 2;
  static Shares<2> at(Lanes const& x) {
    Lanes const s = x - Real(0.5);  // in cell widths from the centre of cell 0
    Lanes const left = round_down(s);
    Lanes const right_share = s - left;
    return {left, {1 - right_share, right_share}};
  }
};

/// Triangular cloud of two cell widths (quadratic weighting): the field it feels has a continuous slope.
struct TriangularCloud {
  static constexpr int width = 3;
  static Shares<3> at(Lanes const& x) {
    Lanes const own = round_down(x);
    Lanes const s = x - own;  // in [0, 1), from the lower face of the particle's own cell
    Lanes const left = Real(0.5) * (1 - s) * (1 - s), right = Real(0.5) * s * s;
    return {own - 1, {left, 1 - left - right, right}};
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
