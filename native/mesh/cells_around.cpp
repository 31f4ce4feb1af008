#include "mesh/cells_around.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "base/error.hpp"

namespace amrpic {

namespace {

constexpr Real equal = 1 + 1e-9;  ///< radii that rounding alone tells apart

/// The box of a level that holds a cell, or -1: most often that of the cell before it.
class Finder {
 public:
  explicit Finder(Level const& level) : level_(level) {}
  int operator()(Index3 const& cell) {
    if (last_ < 0 || !level_.box(last_).contains(cell)) last_ = level_.find(cell);
    return last_;
  }

 private:
  Level const& level_;
  int last_ = -1;
};

}  // namespace

std::vector<GlobalIndex> first_numbers(Hierarchy const& hierarchy) {
  std::vector<GlobalIndex> out{0};
  for (int l = 0; l < hierarchy.level_count(); ++l) out.push_back(out.back() + hierarchy.level(l).cells());
  if (out.back() > std::numeric_limits<LocalIndex>::max())
    throw HierarchyError("the hierarchy has " + std::to_string(out.back()) + " cells; stencils can number " +
                         std::to_string(std::numeric_limits<LocalIndex>::max()) +
                         " at most; take fewer levels or wider cells");
  return out;
}

CellsAround cells_around(Hierarchy const& hierarchy, std::vector<Real3> const& points,
                         std::vector<Real> const& radius) {
  std::vector<Finder> find;
  auto const first = first_numbers(hierarchy);
  for (int l = 0; l < hierarchy.level_count(); ++l) find.emplace_back(hierarchy.level(l));
  CellsAround out;
  for (std::size_t p = 0; p < points.size(); ++p) {
    Real const within = radius[p] * radius[p] * equal;
    for (int l = 0; l < hierarchy.level_count(); ++l) {
      Level const& level = hierarchy.level(l);
      Real3 place;  // of the point, in cells from the first centre
      Box near;
      for (int d = 0; d < 3; ++d) {
        Real const h = level.spacing()[d];
        place[d] = (points[p][d] - hierarchy.domain().lower[d]) / h - 0.5;
        near.lower[d] = std::max(level.domain().lower[d], int(std::ceil(place[d] - radius[p] * equal / h)));
        near.upper[d] = std::min(level.domain().upper[d], int(std::floor(place[d] + radius[p] * equal / h)));
      }
      for_each_cell(near, [&](Index3 const& cell) {
        Real square = 0;
        for (int d = 0; d < 3; ++d) {
          Real const away = (place[d] - cell[d]) * level.spacing()[d];
          square += away * away;
        }
        if (square > within) return;
        int const box = find[std::size_t(l)](cell);
        if (box < 0) return;
        if (hierarchy.has_finer(l) && find[std::size_t(l + 1)](first_child_of(cell)) >= 0) return;
        GlobalIndex const number = first[std::size_t(l)] + level.box_offset(box) + level.box(box).offset(cell);
        out.cell.push_back(LocalIndex(number));
      });
    }
    std::sort(out.cell.begin() + out.start.back(), out.cell.end());
    out.start.push_back(std::int64_t(out.cell.size()));
  }
  return out;
}

}  // namespace amrpic
