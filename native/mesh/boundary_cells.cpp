#include "mesh/boundary_cells.hpp"

#include <algorithm>
#include <string>

#include "base/error.hpp"

namespace amrpic {

BoundaryCells::BoundaryCells(LevelFaces const& boxes) : first_{0}, first_cell_{0} {
  for (BoxFaces const& faces : boxes) {
    Box const& box = faces.box;
    Index3 const n{box.extent(0), box.extent(1), box.extent(2)};
    bool const whole = std::min({n[0], n[1], n[2]}) <= 2 || !faces.covered.empty();
    LocalIndex const cells = LocalIndex(box.cells()), inside = (n[0] - 2) * (n[1] - 2) * (n[2] - 2);
    extent_.push_back(n);
    whole_.push_back(whole);
    first_.push_back(first_.back() + cells - (whole ? 0 : inside));
    first_cell_.push_back(first_cell_.back() + cells);
  }
}

LocalIndex BoundaryCells::number(int b, Index3 const& cell) const {
  auto const [nx, ny, nz] = extent_[std::size_t(b)];
  auto const [i, j, k] = cell;
  LocalIndex const plane = nx * ny, rows = 2 * plane, columns = rows + 2 * (nz - 2) * nx;
  LocalIndex out = -1;
  if (whole_[std::size_t(b)])
    out = i + nx * j + plane * k;
  else if (k == 0 || k == nz - 1)
    out = i + nx * j + (k == 0 ? 0 : plane);
  else if (j == 0 || j == ny - 1)
    out = rows + i + nx * (k - 1 + (j == 0 ? 0 : nz - 2));
  else if (i == 0 || i == nx - 1)
    out = columns + j - 1 + (ny - 2) * (k - 1 + (i == 0 ? 0 : nz - 2));
  return out < 0 ? out : first_[std::size_t(b)] + out;
}

LocalIndex BoundaryCells::number(LocalIndex place, std::size_t& box) const {
  if (place < first_cell_[box] || place >= first_cell_[box + 1])
    box = std::size_t(std::upper_bound(first_cell_.begin(), first_cell_.end(), place) - first_cell_.begin() - 1);
  int const cell = place - first_cell_[box], nx = extent_[box][0], ny = extent_[box][1];
  LocalIndex const out =
      whole_[box] ? first_[box] + cell : number(int(box), {cell % nx, cell / nx % ny, cell / nx / ny});
  if (out < 0) fail_alone("cell " + std::to_string(place) + " of a level is no boundary cell of its box");
  return out;
}

}  // namespace amrpic
