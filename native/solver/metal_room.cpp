#include "solver/metal_room.hpp"

#include <cstdio>
#include <limits>

#include "base/error.hpp"

namespace amrpic {

namespace {

bool is_at_open_face(Hierarchy const& hierarchy, Level const& level, Index3 const& cell) {
  for (int d = 0; d < 3; ++d)
    for (int side = 0; side < 2; ++side)
      if (hierarchy.domain().boundary[d][side] == Boundary::open &&
          cell[d] == (side == 0 ? level.domain().lower : level.domain().upper)[d])
        return true;
  return false;
}

/// The first of this rank's cells in or beside metal, level by level, that is refused; its number among all cells.
template <class Refused>
GlobalIndex first_refused(MetalCells const& metal, Level const& level, Refused&& refused) {
  GlobalIndex out = std::numeric_limits<GlobalIndex>::max();
  auto const look = [&](Index3 const& cell) {
    if (!refused(cell)) return;
    int const b = level.find(cell);
    if (b >= 0 && level.owner(b) == level.rank()) out = std::min(out, level.domain().offset(cell));
  };
  for (CutCell const& c : metal.cut()) look(c.cell);
  for (SolidCells const& run : metal.solid())
    for (Index3 cell = run.first; cell[0] < run.first[0] + run.count; ++cell[0]) look(cell);
  return out;
}

std::string place_of(Hierarchy const& hierarchy, Level const& level, GlobalIndex number, Real3 const& stretch) {
  Box const& domain = level.domain();
  GlobalIndex const nx = domain.extent(0), ny = domain.extent(1);
  GlobalIndex const cell[3] = {number % nx, number / nx % ny, number / nx / ny};
  Real x[3];
  for (int d = 0; d < 3; ++d)
    x[d] = (hierarchy.domain().lower[d] + (Real(cell[d]) + 0.5) * level.spacing()[d]) / stretch[d];
  char out[120];
  std::snprintf(out, sizeof out, "(%.4g, %.4g, %.4g) m", x[0], x[1], x[2]);
  return out;
}

}  // namespace

void require_room_around(Metal const& metal, Hierarchy const& hierarchy, Real3 const& stretch) {
  for (int l = 0; l < hierarchy.level_count(); ++l) {
    Level const& level = hierarchy.level(l);
    MetalCells const cells = metal.own_cells(level);  // also for those that ask for parts of them
    if (!hierarchy.domain().has(Boundary::open)) continue;
    GlobalIndex const open = hierarchy.comm().smallest(
        first_refused(cells, level, [&](Index3 const& cell) { return is_at_open_face(hierarchy, level, cell); }));
    if (open != std::numeric_limits<GlobalIndex>::max())
      throw SolverError("an electrode meets an open face of the domain at " +
                        place_of(hierarchy, level, open, stretch) +
                        "; leave room between them, or give that face a potential");
  }
}

}  // namespace amrpic
