#pragma once

#include <array>
#include <memory>
#include <vector>

#include "mesh/hierarchy.hpp"
#include "multigrid/stencil_cells.hpp"
#include "stencil/equation.hpp"
#include "stencil/odd_extents.hpp"
#include "stencil/wall_ghost.hpp"

namespace amrpic {

class OpenWalls;

/// Levels for which operators are made, coarse to fine: up to and including the base each covers the domain; then come
/// the refinement levels.
struct MultigridLevels {
  std::vector<std::shared_ptr<Level const>> levels;
  std::vector<std::shared_ptr<LevelFaces const>> faces;  ///< [l], of the base and finer levels; null on coarser ones
  std::vector<Index3> ratio;  ///< [l]: cells of level l per cell of level l - 1; 2 on refinement levels
  /// [l]: whether level l - 1 covers the domain with the parents of each box of level l in the box of the same number,
  /// on the same rank.
  std::vector<char> parents_in_place;
  std::vector<WallGhosts> walls;
  std::vector<std::array<UpperEnd, 3>> upper;  ///< [l][axis]
  std::array<std::array<Boundary, 2>, 3> boundary;
  std::size_t base = 0;  ///< the base level's place
  Real shift = 0;        ///< kappa^2 of the screened equation, in 1/m^2

  Equation equation(std::size_t l) const { return equation_on(levels[l]->spacing(), shift); }

  bool refines(std::size_t l) const { return l > base && l < levels.size(); }
  /// The levels that l refines and that refine it.
  LevelsBeside beside(std::size_t l) const {
    auto const finer = [&](std::size_t f) { return refines(f) ? levels[f].get() : nullptr; };
    return {refines(l) ? levels[l - 1].get() : nullptr, finer(l + 1), finer(l + 2)};
  }
  /// Whether the next coarser level may be of like size: a coarser one than a refinement level, or than a level with
  /// half its cells along one axis alone. An F-cycle over such levels costs more than it saves.
  bool halves_at_most(std::size_t l) const {
    return refines(l) || (l > 0 && ratio[l][0] * ratio[l][1] * ratio[l][2] == 2);
  }
};

/// The base and the refinement levels; `coarsen_below` adds coarser ones. `order`: of the residual that the corrections
/// are for, which has its own walls.
MultigridLevels refinement_levels(Hierarchy const& hierarchy, Real shift, int order = 2);

/// How multigrid levels are distributed over ranks.
struct CoarseBoxes {
  int max_grid_size;      ///< cells of a box along an axis, where new boxes are cut
  GlobalIndex whole = 0;  ///< every rank stores levels of at most so many cells whole: Levels of one rank
};

/// The levels with coarser ones below the base, at most `most` in all. Each pairs the cells of the next finer one along
/// the axes of smallest spacing, whatever their number; the coarsest has at most 64 cells unless `most` is reached.
///
/// Boxes stay on their ranks while they can be halved with all children of a cell in one box, and while there are 8^3
/// cells per rank; below that those of 8 ranks after each other come together on the first of them. Where boxes cannot
/// be halved new ones are made.
MultigridLevels coarsen_below(MultigridLevels multigrid, Domain const& domain, CoarseBoxes const& boxes, int most);

/// Boxes in their final order, and where each rank's run of them starts.
struct DistributedBoxes {
  std::vector<Box> boxes;
  std::vector<int> first;
};

/// A level's boxes halved along some axes, on the same ranks; none if a cell's children would not fill a box, except at
/// the domain's upper end, or would be in two boxes on the next coarser level. `domain`: the coarser one.
DistributedBoxes halved(Level const& finer, Index3 const& ratio, Box const& domain);

/// Sort boxes along the curve, and distribute them by cells: where each rank's run starts.
std::vector<int> distribute_along_curve(std::vector<Box>& boxes, int ranks);

/// The levels as another rank has them, that of the hierarchy: the same one as a virtual rank sees it. Local.
MultigridLevels seen_by(MultigridLevels multigrid, Hierarchy const& hierarchy);

/// Factor of the last cell in the ghost behind a wall that prolongation from level l reads.
Real prolonged_end(MultigridLevels const& multigrid, OpenWalls const& open_walls, std::size_t l, Index3 const& cell,
                   int axis, int side);

/// What the children of a level's cells weigh at the upper ends of a level `finer`; see `last_children`.
std::array<LastChildren, 3> last_children_of(MultigridLevels const& multigrid, std::size_t finer);

}  // namespace amrpic
