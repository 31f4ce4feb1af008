#include "multigrid/metal_on_levels.hpp"

#include <algorithm>

namespace amrpic {

std::vector<Level const*> levels_of_potential(MultigridLevels const& multigrid, std::size_t first) {
  std::vector<Level const*> out;
  for (std::size_t l = std::max(first, multigrid.base); l < multigrid.levels.size(); ++l)
    out.push_back(multigrid.levels[l].get());
  return out;
}

MetalCells metal_on(Metal const& metal, MultigridLevels const& multigrid, std::size_t l,
                    std::vector<Box> const& boxes) {
  Level const& level = *multigrid.levels[l];
  auto const finer = levels_of_potential(multigrid, l + 1);
  if (l < multigrid.base) return metal.cells(level, boxes, finer);
  return metal_of_level(metal, level, multigrid.beside(l).coarser, finer, boxes, true).cells;
}

MetalCells metal_on(Metal const& metal, CycleLevels const& levels, std::size_t l, std::vector<Box> const& boxes) {
  MultigridLevels const& multigrid = levels;
  if (!levels.semicoarse(l)) return metal_on(metal, multigrid, l, boxes);
  std::size_t corrected = l;
  while (levels.semicoarse(corrected)) corrected = levels.finer(corrected);
  return metal.cells(*levels.level(l), boxes, levels_of_potential(multigrid, corrected));
}

}  // namespace amrpic
