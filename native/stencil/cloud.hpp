// The clouds that particles are spread into. A shape gives, along one axis, the cells that a particle touches and the
// weight of each; deposit and gather use the same weights, so that a particle does not push itself on a uniform grid.
// No shape reaches further than one cell beyond the particle's own.
#pragma once

#include <array>

#include "base/lanes.hpp"

namespace amrpic {

/// Cells that clouds touch along an axis, and the weight of each.
template <int cells, class Value>
struct CloudWeights {
  Value first;                      ///< leftmost cell touched, a whole number
  std::array<Value, cells> weight;  ///< sum to one
};

// Each shape: the weights of particles at `x`, in cell widths from the lower face of cell 0.

/// All charge in the particle's own cell; the field it feels jumps from cell to cell.
struct NearestGridPoint {
  static constexpr int width = 1;
  template <class Value>
  KOKKOS_INLINE_FUNCTION static CloudWeights<1, Value> at(Value const& x) {
    return {round_down(x), {Value{} + 1}};
  }
};

/// Uniform cloud of one cell width (linear weighting).
struct CloudInCell {
  static constexpr int width = 2;
  template <class Value>
  KOKKOS_INLINE_FUNCTION static CloudWeights<2, Value> at(Value const& x) {
    Value const s = x - Real(0.5);  // in cell widths from the centre of cell 0
    Value const left = round_down(s);
    Value const upper = s - left;
    return {left, {1 - upper, upper}};
  }
};

/// Triangular cloud of two cell widths (quadratic weighting): the field it feels has a continuous slope.
struct TriangularCloud {
  static constexpr int width = 3;
  template <class Value>
  KOKKOS_INLINE_FUNCTION static CloudWeights<3, Value> at(Value const& x) {
    Value const own = round_down(x);
    Value const s = x - own;  // in [0, 1), from the lower face of the particle's own cell
    Value const left = Real(0.5) * (1 - s) * (1 - s), right = Real(0.5) * s * s;
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
