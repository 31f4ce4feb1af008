#include "matrixfree/direct.hpp"

#include <cmath>
#include <stdexcept>

extern "C" void dsyev_(char const* vectors, char const* triangle, int const* n, double* matrix, int const* leading,
                       double* eigenvalues, double* work, int const* size_of_work, int* info);

namespace amrpic::matrixfree {

FastDiagonalisation::FastDiagonalisation(Index3 const& cells, Equation const& equation, WallGhosts const& walls,
                                         std::array<bool, 3> const& periodic, Real3 const& seam_width, bool leaves_mean)
    : cells_(cells), shift_(equation.shift), leaves_mean_(leaves_mean) {
  for (int d = 0; d < 3; ++d) axes_[d] = axis(cells[d], equation.weight[d], walls[d], periodic[d], seam_width[d]);
}

FastDiagonalisation::Axis FastDiagonalisation::axis(int n, Real weight, std::array<WallGhost, 2> const& walls,
                                                    bool periodic, Real seam_width) {
  std::size_t const size = std::size_t(n);
  std::vector<Real> matrix(size * size, 0.0);  // column by column
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

}  // namespace amrpic::matrixfree
