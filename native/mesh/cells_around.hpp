#pragma once

#include <vector>

#include "mesh/hierarchy.hpp"

namespace amrpic {

/// The cells near each point: those of point p are `cell` from start[p] to start[p + 1], ascending. Cells of all levels
/// are numbered level by level, box by box, x fastest.
struct CellsAround {
  std::vector<std::int64_t> start{0};
  std::vector<LocalIndex> cell;
};

/// The cells of all levels that no finer one covers and whose centres lie within a radius of each point. They end at
/// the faces of the domain, periodic ones too. Local: boxes are known on all ranks.
CellsAround cells_around(Hierarchy const& hierarchy, std::vector<Real3> const& points, std::vector<Real> const& radius);

/// The number of the first cell of each level, and of all cells, where these are numbered level after level. Throws
/// HierarchyError, the same on all ranks, if 32 bits do not count them.
std::vector<GlobalIndex> first_numbers(Hierarchy const& hierarchy);

}  // namespace amrpic
