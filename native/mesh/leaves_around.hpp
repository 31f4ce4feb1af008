#pragma once

#include <vector>

#include "mesh/hierarchy.hpp"

namespace amrpic {

/// The leaves of a hierarchy, the cells that no finer one covers, each with the leaves near it: those of leaf t are
/// `cell` from start[t] to start[t + 1], ordered by their offsets along z, y, x. Cells are numbered as in
/// `CellsAround`. Leaves of equal kind are of one level, and have leaves at the same offsets.
struct LeavesAround {
  std::vector<LocalIndex> leaf;
  std::vector<Real> radius;  ///< of each leaf
  std::vector<std::int64_t> start{0};
  std::vector<LocalIndex> cell;
  std::vector<LocalIndex> kind;            ///< of each leaf
  std::vector<LocalIndex> representative;  ///< a leaf of each kind, by its place in `leaf`
};

/// All leaves, box by box, with those whose centres lie within `reach` times their own longest edge. They end at the
/// faces of the domain, periodic ones too. Local: boxes are known on all ranks.
LeavesAround leaves_around(Hierarchy const& hierarchy, Real reach);

}  // namespace amrpic
