#pragma once

#include "multigrid/multigrid_levels.hpp"

namespace amrpic {

/// Where corrections vanish behind open walls.
///
/// On each refinement level the potential is given at the ghost centres, half a cell outside; so a correction vanishes
/// there, at another distance on each level. A coarser level that corrects finer ones must let it vanish where they do:
/// with rows that put the zero at their own ghost centres, a region refined twice at an open wall took 18 cycles for 7.
class OpenWalls {
 public:
  explicit OpenWalls(MultigridLevels const& multigrid);
  /// Whether a refinement level touches an open wall.
  bool are_refined() const { return refined_ != decltype(refined_){}; }

  /// Factor of the first cell inside in the ghost of a correction behind an open wall. The correction vanishes h / 2
  /// behind the wall, h the mean spacing of the finest cells at that part of it. Zero where nothing is finer. The cell
  /// may be an image behind a periodic face.
  Real first(std::size_t l, Index3 const& cell, int axis, int side) const;

 private:
  /// Mean spacing along the axis of the finest cells behind a cell's face at the wall.
  Real finest_spacing(std::size_t l, Index3 const& cell, int axis, int side) const;

  MultigridLevels const& multigrid_;
  std::array<std::array<bool, 2>, 3> refined_{};  ///< whether a refinement level touches the wall
};

}  // namespace amrpic
