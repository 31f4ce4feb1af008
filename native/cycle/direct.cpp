#include "cycle/direct.hpp"

#include <cmath>
#include <stdexcept>
#include <utility>

extern "C" void dgetrf_(int const* rows, int const* columns, double* matrix, int const* leading, int* pivots,
                        int* info);
extern "C" void dsyev_(char const* vectors, char const* triangle, int const* n, double* matrix, int const* leading,
                       double* eigenvalues, double* work, int const* size_of_work, int* info);

namespace amrpic::cycle {

namespace {

/// The second difference along an axis times a weight, column by column.
std::vector<Real> second_differences(int n, Real weight, std::array<WallGhost, 2> const& walls, bool periodic,
                                     Real seam_width) {
  std::size_t const size = std::size_t(n);
  std::vector<Real> matrix(size * size, 0.0);
  auto at = [&](int i, int j) -> Real& { return matrix[std::size_t(i) + size * std::size_t(j)]; };
  for (int i = 0; i < n; ++i) {
    for (int side = 0; side < 2; ++side) {
      int const step = side == 0 ? -1 : 1, j = i + step;
      if (periodic || (j >= 0 && j < n)) {
        Real const factor = periodic ? weight * seam_factor(i, side, n, seam_width) : weight;
        at(i, i) -= factor;
        at(i, (j + n) % n) += factor;
      } else {
        at(i, i) += weight * (walls[side].first - 1);
        if (n > 1) at(i, i - step) += weight * walls[side].second;
      }
    }
  }
  return matrix;
}

}  // namespace

FastDiagonalisation::FastDiagonalisation(Index3 const& cells, Equation const& equation, WallGhosts const& walls,
                                         std::array<bool, 3> const& periodic, Real3 const& seam_width, bool leaves_mean)
    : cells_(cells), shift_(equation.shift), leaves_mean_(leaves_mean) {
  for (int d = 0; d < 3; ++d) axes_[d] = axis(cells[d], equation.weight[d], walls[d], periodic[d], seam_width[d]);
}

FastDiagonalisation::Axis FastDiagonalisation::axis(int n, Real weight, std::array<WallGhost, 2> const& walls,
                                                    bool periodic, Real seam_width) {
  std::size_t const size = std::size_t(n);
  std::vector<Real> matrix = second_differences(n, weight, walls, periodic, seam_width);
  auto at = [&](int i, int j) -> Real& { return matrix[std::size_t(i) + size * std::size_t(j)]; };
  // A wall's second cell, or a volume of its own, makes the matrix unsymmetric; in other units of each cell it is
  // symmetric.
  std::vector<Real> unit(size, 1.0);
  for (int i = 1; i < n; ++i) unit[std::size_t(i)] = unit[std::size_t(i - 1)] * std::sqrt(at(i, i - 1) / at(i - 1, i));
  for (int j = 0; j < n; ++j)
    for (int i = 0; i < n; ++i) at(i, j) *= unit[std::size_t(j)] / unit[std::size_t(i)];

  Axis out;
  out.eigenvalue.resize(size);
  std::vector<Real> work(8 * size + 64);
  int const work_size = int(work.size());
  int info = 0;
  dsyev_("V", "U", &n, matrix.data(), &n, out.eigenvalue.data(), work.data(), &work_size, &info);
  if (info != 0) throw std::runtime_error("the eigenvalues of the coarsest level could not be found");
  // Rounding leaves the last one at epsilon times the first where nothing holds what is constant along the axis.
  auto const is_free = [](WallGhost const& ghost) { return std::abs(ghost.first + ghost.second - 1) < 1e-12; };
  if (periodic || (is_free(walls[0]) && is_free(walls[1]))) out.eigenvalue.back() = 0;
  out.to.resize(size * size), out.from.resize(size * size);
  for (std::size_t i = 0; i < size; ++i)
    for (std::size_t k = 0; k < size; ++k) {
      out.to[k * size + i] = matrix[i + size * k] / unit[i];
      out.from[i * size + k] = matrix[i + size * k] * unit[i];
    }
  return out;
}

/// Multiply the lines along an axis by a matrix.
void FastDiagonalisation::transform(int axis, std::vector<Real> const& matrix, std::vector<Real>& values) {
  std::size_t const n = std::size_t(cells_[axis]);
  std::size_t stride = 1, outer = 1;
  for (int d = 0; d < axis; ++d) stride *= std::size_t(cells_[d]);
  for (int d = axis + 1; d < 3; ++d) outer *= std::size_t(cells_[d]);
  scratch_.assign(values.size(), 0.0);
  for (std::size_t o = 0; o < outer; ++o)
    for (std::size_t i = 0; i < n; ++i)
      for (std::size_t j = 0; j < n; ++j) {
        Real const factor = matrix[i * n + j];
        Real const* const from = &values[(o * n + j) * stride];
        Real* const to = &scratch_[(o * n + i) * stride];
        for (std::size_t s = 0; s < stride; ++s) to[s] += factor * from[s];
      }
  values.swap(scratch_);
}

void FastDiagonalisation::solve(std::vector<Real>& values) {
  for (int d = 0; d < 3; ++d) transform(d, axes_[d].to, values);
  Real largest = 0;
  for (Axis const& a : axes_)
    for (Real v : a.eigenvalue) largest = std::max(largest, std::abs(v));
  std::size_t n = 0;
  for (Real z : axes_[2].eigenvalue)
    for (Real y : axes_[1].eigenvalue)
      for (Real x : axes_[0].eigenvalue) {
        bool const is_constant = leaves_mean_ && std::abs(x + y + z) <= 1e-12 * largest;
        values[n] = is_constant ? 0 : values[n] / (x + y + z - shift_);
        ++n;
      }
  for (int d = 0; d < 3; ++d) transform(d, axes_[d].from, values);
}

DenseRows::DenseRows(Index3 const& cells, Equation const& equation, WallGhosts const& walls,
                     std::array<bool, 3> const& periodic, Real3 const& seam_width, MetalCells const& metal)
    : pivots_(std::size_t(cells[0]) * cells[1] * cells[2]) {
  Box const box{{0, 0, 0}, {cells[0] - 1, cells[1] - 1, cells[2] - 1}};
  std::size_t const size = pivots_.size();
  matrix_.resize(size * size);
  auto at = [&](Index3 const& row, Index3 const& column) -> Real& {
    return matrix_[std::size_t(box.offset(row)) + size * std::size_t(box.offset(column))];
  };
  auto const along = [](Index3 cell, int axis, int place) {
    cell[axis] = place;
    return cell;
  };
  auto const clear_row = [&](Index3 const& cell) {
    for_each_cell(box, [&](Index3 const& column) { at(cell, column) = 0; });
  };
  for_each_cell(box, [&](Index3 const& cell) { at(cell, cell) = -equation.shift; });
  for (int d = 0; d < 3; ++d) {
    int const n = cells[d];
    auto const differences = second_differences(n, equation.weight[d], walls[d], periodic[d], seam_width[d]);
    for_each_cell(box, [&](Index3 const& cell) {
      for (int i = 0; i < n; ++i) at(cell, along(cell, d, i)) += differences[std::size_t(cell[d] + n * i)];
    });
  }
  for (CutCell const& cut : metal.cut()) {
    std::array<Arm, 6> arms;
    std::array<Real, 6> factor;  // of the value beyond
    std::array<Index3, 6> place;
    for (std::size_t side = 0; side < 6; ++side) {
      int const d = int(side) / 2, s = int(side) % 2, n = cells[d], next = cut.cell[d] + (s == 0 ? -1 : 1);
      bool const wall = !periodic[d] && (next < 0 || next >= n);
      arms[side] = arm_of(cut, side);
      factor[side] = periodic[d] ? seam_factor(cut.cell[d], s, n, seam_width[d]) : 1;
      place[side] = along(cut.cell, d, (next + n) % n);
      if (!wall) {
        arms[side].first = 1 - factor[side];
        continue;
      }
      WallGhost const& ghost = walls[std::size_t(d)][std::size_t(s)];
      arms[side].first = ghost.first, arms[side].is_parabola = ghost.second != 0;
      factor[side] = n > 1 ? ghost.second : 0;
      place[side] = along(cut.cell, d, n > 1 ? cut.cell[d] - (s == 0 ? -1 : 1) : 0);
    }
    CutRow const row = cut_row(equation, arms, cut.hold);
    clear_row(cut.cell);
    at(cut.cell, cut.cell) = -row.diagonal;
    for (std::size_t side = 0; side < 6; ++side) at(cut.cell, place[side]) += row.neighbour(side) * factor[side];
  }
  for_each_row(box, [&](Index3 const& first) {
    metal.for_each_solid(first, box.extent(0), [&](SolidCell const& solid) {
      clear_row(solid.cell);
      at(solid.cell, solid.cell) = -equation.diagonal();
      solid_.push_back(std::size_t(box.offset(solid.cell)));
    });
  });
  int const n = int(size);
  int info = 0;
  dgetrf_(&n, &n, matrix_.data(), &n, pivots_.data(), &info);
  if (info != 0) throw std::runtime_error("the equations of the coarsest level beside electrodes are singular");
}

void DenseRows::solve(std::vector<Real>& values) {
  // Not by the library, whose threads take longer to meet than the few sums.
  std::size_t const n = pivots_.size();
  Real* const x = values.data();
  for (std::size_t i = 0; i < n; ++i) std::swap(x[i], x[pivots_[i] - 1]);
  for (std::size_t j = 0; j < n; ++j) {
    Real const* const column = &matrix_[n * j];
    for (std::size_t i = j + 1; i < n; ++i) x[i] -= column[i] * x[j];
  }
  for (std::size_t j = n; j-- > 0;) {
    Real const* const column = &matrix_[n * j];
    x[j] /= column[j];
    for (std::size_t i = 0; i < j; ++i) x[i] -= column[i] * x[j];
  }
  for (std::size_t place : solid_) values[place] = 0;
}

}  // namespace amrpic::cycle
