#include "solver/work_unit.hpp"

#include <mpi.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace amrpic {

namespace {

template <class F>
Real best_of_five(F&& f) {
  Real best = std::numeric_limits<Real>::max();
  for (int trial = 0; trial < 5; ++trial) {
    double const start = MPI_Wtime();
    f();
    best = std::min(best, MPI_Wtime() - start);
  }
  return best;
}

void apply(std::ptrdiff_t n, std::ptrdiff_t planes, Real const* __restrict x, Real* __restrict y) {
  for (std::ptrdiff_t row = n + 1; row < (planes - 1) * n - 1; ++row) {
    Real const* const here = x + row * n;
    Real* const there = y + row * n;
    for (std::ptrdiff_t i = 0; i < n; ++i)
      there[i] =
          here[i - 1] + here[i + 1] + here[i - n] + here[i + n] + here[i - n * n] + here[i + n * n] - 6 * here[i];
  }
}

void triad(std::size_t size, Real s, Real* __restrict a, Real const* __restrict b, Real const* __restrict c) {
  for (std::size_t i = 0; i < size; ++i) a[i] = b[i] + s * c[i];
}

}  // namespace

WorkUnit measure_work_unit(GlobalIndex cells) {
  auto const n = std::max<std::ptrdiff_t>(8, std::ptrdiff_t(std::cbrt(Real(cells))));
  auto const planes = std::max<std::ptrdiff_t>(8, cells / (n * n));
  std::size_t const size = std::size_t(n * n * planes);
  std::vector<Real> x(size, 1.0), y(size, 2.0), z(size, 3.0);
  WorkUnit out;
  out.apply_seconds = best_of_five([&] { apply(n, planes, x.data(), y.data()); });
  out.triad_seconds = best_of_five([&] { triad(size, 0.5, z.data(), x.data(), y.data()); });
  return out;
}

}  // namespace amrpic
