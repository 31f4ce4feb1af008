// Rows of a tile as differences of values across cells.
#pragma once

#include "base/fetch.hpp"
#include "base/lanes.hpp"
#include "particle/lane_groups.hpp"
#include "stencil/field_difference.hpp"

namespace amrpic {

/// Three components per cell of a tile and one of padding, so that a cell fills a vector register.
constexpr int lanes = 4;
typedef Real Cell __attribute__((vector_size(8 * lanes)));

/// A row of cells inside a box: between(at, n, axis, step) of each cell n, from what at(address) says of one or eight.
template <class Between>
inline void write_row(Between const& between, std::ptrdiff_t y, std::ptrdiff_t z, int count, Real* out) {
  int const whole = count / lane_count * lane_count;
  for (int i = 0; i < whole; i += lane_count) {
    auto const eight = [](Real const* from) { return load<Lanes>(from); };
    interleave(between(eight, i, 0, 1), between(eight, i, 1, y), between(eight, i, 2, z), out + lanes * i);
  }
  auto const one = [](Real const* from) { return *from; };
  for (int i = whole; i < count; ++i)
    store(out + lanes * i, Cell{between(one, i, 0, 1), between(one, i, 1, y), between(one, i, 2, z), 0});
}

/// Values in a row of cells, and what `field_between` takes of them. Cells beside the row are read.
struct DifferenceRow {
  Real const* values;
  Real3 const& factor;

  template <class At>
  auto between(At const& at, std::ptrdiff_t n, int axis, std::ptrdiff_t step) const {
    return field_between(factor[std::size_t(axis)], at(values + n - step), at(values + n + step));
  }
  void bring_next_near(std::ptrdiff_t z, int count) const {
    for (int i = 0; i < count; i += lane_count) bring_near(values + i + z + page<Real>);  // harmless past the end
  }
};

}  // namespace amrpic
