#pragma once

#include <cstdint>
#include <vector>

#include "mesh/hierarchy.hpp"

namespace amrpic {

struct RefineOptions {
  int max_levels;   ///< most levels of the result, the base included
  int buffer;       ///< cells around a tagged cell that are refined with it
  int nesting;      ///< cells of a level around the next finer one, at least 1
  Real efficiency;  ///< least fraction of a box's blocks that must be refined, unless it is a single block
};

/// What the tag of a cell says; one may say both.
constexpr std::uint8_t wanted = 1;  ///< its children, and those of the cells in the buffer around it, shall exist
constexpr std::uint8_t kept = 2;    ///< they shall stay where they exist already

/// Boxes of levels 1, 2, ... that refine all tagged cells and hold all `fixed` boxes, properly nested. Collective.
///
/// `tags[l]` points to one byte per cell of this rank on level l; null or missing: no tags. `fixed[k]` lists boxes of
/// level k + 1 in its own indices; they are aligned outward to the blocking factor, wrapped where periodic and clipped
/// elsewhere. The boxes are aligned, disjoint and inside the domain, they depend on tags, `fixed` and, for kept cells,
/// where levels lie at present, not on how they are cut or distributed, and the list ends before the first empty level.
std::vector<std::vector<Box>> refine(Hierarchy const& hierarchy, std::vector<std::uint8_t const*> const& tags,
                                     std::vector<std::vector<Box>> const& fixed, RefineOptions const& options);

}  // namespace amrpic
