#pragma once

#include <array>
#include <vector>

#include "mesh/box.hpp"

namespace amrpic {

/// Where boxes must not be joined: along an axis before the index `first` or the one that follows it, and whole periods
/// away from there.
struct Seam {
  int first = 0, period = 0;  ///< period 0: nowhere

  bool lies_before(int i) const { return period > 0 && ((i - first) % period == 0 || (i - first - 1) % period == 0); }
};

/// Fewer, larger boxes that hold the same cells: neighbours with a common face of equal extent are joined.
std::vector<Box> joined(std::vector<Box> boxes, std::array<Seam, 3> const& seams = {});

/// Boxes cut at seams.
std::vector<Box> split(std::vector<Box> boxes, std::array<Seam, 3> const& seams);

/// What is left of disjoint boxes outside another one.
std::vector<Box> without(std::vector<Box> const& boxes, Box const& hole);

}  // namespace amrpic
