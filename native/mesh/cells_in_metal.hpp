// Cells in metal, as lines find them along each axis, and the runs that they make.
#pragma once

#include <cstdint>
#include <vector>

#include "mesh/box.hpp"

namespace amrpic {

/// Stretches of cells along an axis: `count` from number `first` on, `stride` apart.
struct Stretches {
  std::int64_t const *first, *count, *stride;
  std::size_t size;
};

/// Give cells to an electrode, and add the bits of an axis to theirs.
void mark(Stretches const& stretches, std::int32_t electrode, std::uint8_t axis, std::int32_t* owner,
          std::uint8_t* axes);

/// Runs of cells of one electrode along x.
struct Runs {
  std::vector<std::int64_t> first;  ///< x, y, z of each
  std::vector<std::int32_t> count, electrode;
};

/// Those in boxes, by the owners of the cells of each and of a layer around it, box after box, x fastest; -1 of others.
Runs runs_in(std::vector<Box> const& boxes, std::int32_t const* owner);

}  // namespace amrpic
