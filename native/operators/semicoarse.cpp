#include "operators/semicoarse.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "operators/regular_rows.hpp"
#include "stencil/interface.hpp"

namespace amrpic {

namespace {

std::shared_ptr<Level const> coarsened(Level const& level, Index3 const& ratio) {
  Real3 spacing = level.spacing();
  for (int d = 0; d < 3; ++d) spacing[d] *= ratio[d];
  std::vector<Box> boxes;
  for (Box const& box : level.boxes()) boxes.push_back(box.coarsen(ratio));
  std::vector<int> first;
  for (int r = 0; r <= level.ranks(); ++r) first.push_back(level.first_box(r));
  return std::make_shared<Level const>(level.domain().coarsen(ratio), level.periodic(), spacing, std::move(boxes),
                                       std::move(first), level.rank());
}

/// The ghost of a correction that vanishes at a distance behind the face.
WallGhost ghost(Real zero, Real spacing) {
  return {std::isinf(zero) ? 1 : (zero - 0.5 * spacing) / (zero + 0.5 * spacing), 0, 0};
}

/// Along an axis that keeps its cells, errors which oscillate meet the level's own ghosts on every coarser copy; along
/// the others the copies only say where corrections vanish.
void coarsen(CorrectionGhosts& ghosts, Index3 const& ratio, Real3 const& spacing) {
  for (int d = 0; d < 3; ++d) {
    if (ratio[d] == 1) continue;
    for (int side = 0; side < 2; ++side) ghosts.wall[d][side] = ghost(ghosts.wall_zero[d][side], spacing[d]);
    ghosts.interface[d] = ghost(ghosts.interface_zero[d], spacing[d]);
  }
}

/// The row of a cell that lacks a neighbour, or has one twice.
Row special_row(Level const& level, Window<GlobalIndex> const& number, CorrectionGhosts const& ghosts,
                Index3 const& cell) {
  Row row;
  row.add(number(cell), 0);  // the diagonal comes first
  for (int axis = 0; axis < 3; ++axis)
    for (int side = 0; side < 2; ++side) {
      Index3 other = cell, inner = cell;
      other[axis] += side == 0 ? -1 : 1;
      inner[axis] -= side == 0 ? -1 : 1;
      bool const at_wall = !level.periodic()[axis] &&
                           (other[axis] < level.domain().lower[axis] || other[axis] > level.domain().upper[axis]);
      Real const weight = 1 / level.spacing()[axis] / level.spacing()[axis];
      if (number(other) != no_cell) {
        row.add(number(cell), -weight);
        row.add(number(other), weight);
      } else {
        WallGhost const& behind = at_wall ? ghosts.wall[axis][side] : ghosts.interface[axis];
        row.add(number(cell), weight * (behind.first - 1));
        if (behind.second != 0) row.add(number(inner), weight * behind.second);
      }
    }
  return row;
}

}  // namespace

CorrectionGhosts correction_ghosts(Level const& level, WallGhosts const& walls,
                                   std::array<std::array<Boundary, 2>, 3> const& boundary) {
  Real3 const& h = level.spacing();
  CorrectionGhosts out{walls, {}, {}, h};  // beyond the level at the coarse cells' centres
  out.interface.fill({interface_ghost::first, interface_ghost::second, 0});
  for (int d = 0; d < 3; ++d)
    for (int side = 0; side < 2; ++side) {
      Boundary const kind = boundary[d][side];
      out.wall_zero[d][side] = kind == Boundary::open      ? 0.5 * h[d]
                               : kind == Boundary::neumann ? std::numeric_limits<Real>::infinity()
                                                           : 0.0;
    }
  return out;
}

bool has_long_cells(Level const& level) {
  auto const [least, most] = std::minmax_element(level.spacing().begin(), level.spacing().end());
  return *most > 2.01 * *least;
}

Index3 semicoarsening_of(Level const& level) {
  Real3 const& h = level.spacing();
  Real const finest = *std::min_element(h.begin(), h.end());
  if (!has_long_cells(level)) return {1, 1, 1};
  Index3 ratio{1, 1, 1};
  for (int d = 0; d < 3; ++d)
    if (h[d] <= 1.5 * finest) ratio[d] = 2;
  for (int d = 0; d < 3; ++d) {
    // red-black order needs an even number of cells around a periodic axis
    if (level.domain().extent(d) % (level.periodic()[d] ? 2 * ratio[d] : ratio[d]) != 0) return {1, 1, 1};
    for (Box const& box : level.boxes())
      if (box.lower[d] % ratio[d] != 0 || box.extent(d) % ratio[d] != 0) return {1, 1, 1};
  }
  return ratio;
}

std::shared_ptr<Level const> semicoarse_level(Level const& level, Index3 const& ratio, CorrectionGhosts& ghosts) {
  auto out = coarsened(level, ratio);
  coarsen(ghosts, ratio, out->spacing());
  return out;
}

LevelOperators semicoarsened(MPI_Comm comm, Level const& fine, Index3 const& ratio, CorrectionGhosts& ghosts) {
  LevelOperators out;
  out.level = semicoarse_level(fine, ratio, ghosts);
  Level const& level = *out.level;
  Real3 const& h = level.spacing();
  CrsBuilder builder(level.local_cells(), level);
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
    auto const number = cell_numbers(level, level.box(b).grow(1));
    auto const kinds = kinds_without_finer(level, level.box(b), number);
    for_each_run(kinds, level.local_offset(b), [&](RowKind kind, Index3 const& first, Run const& run) {
      if (kind == RowKind::regular) return builder.put_run(run, RegularRows::laplacian_terms);
      for_each_in_run(first, run, [&](Index3 const& cell, LocalIndex row) {
        builder.put(row, special_row(level, number, ghosts, cell));
      });
    });
  }
  std::vector<GlobalIndex> remote;
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b)
    append_remote_neighbours(level, level.box(b), remote);
  out.halo = Exchange(comm, level, remote_cells(level, std::move(remote)));
  out.stencil_halo = Exchange(comm, level, out.halo.ghost_numbers());
  builder.start_filling(out.halo);
  for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
    auto const places = out.halo.places(level, level.box(b).grow(1));
    RegularRows const regular(h, places);
    builder.fill_runs(level.box(b), level.local_offset(b), [&](auto const&... where) { regular.laplacian(where...); });
  }
  out.no_fine = builder.take();
  return out;
}

}  // namespace amrpic
