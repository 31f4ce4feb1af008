#include "particle/ghost_cells.hpp"

namespace amrpic {

namespace {

/// Cut a row or column of cells, of which `whole` is given all but how they lie in memory, into runs.
void cut(GhostRun const& whole, std::vector<LocalIndex> const& places, LocalIndex owned, std::vector<GhostRun>& runs) {
  auto const place = [&](LocalIndex n) { return places[std::size_t(whole.number + n * whole.number_stride)]; };
  auto const kind = [&](LocalIndex n) { return place(n) < 0 ? 0 : place(n) < owned ? 1 : 2; };
  for (LocalIndex n = 0; n < whole.count;) {
    GhostRun run = whole;
    run.first = whole.cell(n);
    run.number += n * whole.number_stride;
    run.place = std::max(place(n), LocalIndex(-1));
    run.place_stride = 1;
    for (run.count = 1; n + run.count < whole.count; ++run.count) {
      LocalIndex const next = n + run.count, stride = place(next) - place(next - 1);
      if (kind(next) != kind(n)) break;
      if (kind(n) == 0) continue;
      if (run.count == 1 && whole.axis != 0) run.place_stride = stride;
      if (stride != run.place_stride) break;
    }
    runs.push_back(run);
    n += run.count;
  }
}

}  // namespace

GhostCells::GhostCells(Box const& box, std::vector<LocalIndex> const& places, LocalIndex owned, int reach)
    : cells_(places.size()), first_plane_(box.lower[2] - reach) {
  Box const tile = box.grow(reach);
  LocalIndex number = 0;
  auto const add_row = [&](int j, int k) {
    cut({{tile.lower[0], j, k}, 0, tile.extent(0), -1, 0, number, 1}, places, owned, runs_);
    number += tile.extent(0);
  };
  auto const add_columns = [&](int k) {  // those on both sides of the box take turns
    for (int n = 0; n < 2 * reach; ++n) {
      int const i = n < reach ? tile.lower[0] + n : box.upper[0] + 1 + n - reach;
      cut({{i, box.lower[1], k}, 1, box.extent(1), -1, 0, number + n, 2 * reach}, places, owned, runs_);
    }
    number += 2 * reach * box.extent(1);
  };
  for (int k = tile.lower[2]; k <= tile.upper[2]; ++k) {
    plane_start_.push_back(runs_.size());
    bool const beside = k >= box.lower[2] && k <= box.upper[2];
    for (int j = tile.lower[1]; j <= tile.upper[1]; ++j)
      if (!beside || j < box.lower[1] || j > box.upper[1])
        add_row(j, k);
      else if (j == box.lower[1])
        add_columns(k);
  }
  plane_start_.push_back(runs_.size());
}

}  // namespace amrpic
