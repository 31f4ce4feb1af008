#include "solver/work_unit.hpp"

#include <time.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <memory>
#include <new>

#include "base/large_array.hpp"

namespace amrpic {

namespace {

constexpr std::ptrdiff_t ALIGNMENT = 64;  // bytes; a cache line and the widest vector
constexpr std::ptrdiff_t VALUES_PER_LINE = ALIGNMENT / sizeof(Real);
constexpr std::ptrdiff_t ROWS_PER_TILE = 32;  // of three planes; up to 400 cells a row they stay in a cache of 512 kB
constexpr int TRIALS = 5;
constexpr std::ptrdiff_t TRIAD_LENGTH = 6 * (1 << 20);  // 48 MB; three of them fit no cache of one core
constexpr int TRIAD_TRIALS = 3;

// Bytes that memory moves: 8 for each value read, 16 for each value written, since an ordinary store fetches the line.
constexpr Real APPLY_BYTES = 24;  // per cell; its neighbours come from the cache
constexpr Real TRIAD_BYTES = 32;  // per value

struct Release {
  void operator()(Real* p) const { std::free(p); }
};
using Values = std::unique_ptr<Real[], Release>;

/// `size` values on whole cache lines, written once so that their pages exist.
Values make_values(std::ptrdiff_t size, Real value) {
  std::size_t const lines = std::size_t((size + VALUES_PER_LINE - 1) / VALUES_PER_LINE);
  Values out(static_cast<Real*>(std::aligned_alloc(ALIGNMENT, lines * ALIGNMENT)));
  if (!out) throw std::bad_alloc();
  std::fill_n(out.get(), size, value);
  return out;
}

/// A box of nx · ny · nz cells within one layer of ghosts; rows start on a cache line, ghosts in x are the ends of
/// neighbouring rows.
struct UnitBox {
  std::ptrdiff_t nx, ny, nz;

  explicit UnitBox(GlobalIndex cells) {
    Real const edge = std::cbrt(Real(cells));
    nx = std::max<std::ptrdiff_t>(1, std::lround(edge / VALUES_PER_LINE)) * VALUES_PER_LINE;
    ny = std::max<std::ptrdiff_t>(1, std::lround(std::sqrt(Real(cells) / Real(nx))));
    nz = std::max<std::ptrdiff_t>(1, std::lround(Real(cells) / Real(nx * ny)));
  }

  std::ptrdiff_t cells() const { return nx * ny * nz; }
  std::ptrdiff_t plane() const { return nx * (ny + 2); }
  std::ptrdiff_t first() const { return plane() + nx + VALUES_PER_LINE; }
  std::ptrdiff_t size() const { return first() + plane() * (nz + 1); }
};

/// y = sum of the six neighbours - 6 x. Tiles of rows keep three planes of x in the cache, so x is read once from
/// memory.
void apply(UnitBox s, Real const* __restrict x, Real* __restrict y) {
  std::ptrdiff_t const row = s.nx, plane = s.plane();
  for (std::ptrdiff_t tile = 0; tile < s.ny; tile += ROWS_PER_TILE)
    for (std::ptrdiff_t k = 0; k < s.nz; ++k)
      for (std::ptrdiff_t j = tile; j < std::min(tile + ROWS_PER_TILE, s.ny); ++j) {
        Real const* const here = x + k * plane + j * row;
        Real* const there = y + k * plane + j * row;
        for (std::ptrdiff_t i = 0; i < s.nx; ++i)
          there[i] = here[i - 1] + here[i + 1] + here[i - row] + here[i + row] + here[i - plane] + here[i + plane] -
                     6 * here[i];
      }
}

void triad(std::ptrdiff_t size, Real s, Real* __restrict a, Real const* __restrict b, Real const* __restrict c) {
  for (std::ptrdiff_t i = 0; i < size; ++i) a[i] = b[i] + s * c[i];
}

/// CPU time of this thread: wall time would count how long it waits for its core where others use it as well.
Real now() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return Real(t.tv_sec) + 1e-9 * Real(t.tv_nsec);
}

template <class F>
Real seconds_of(F&& f) {
  Real const start = now();
  f();
  return now() - start;
}

}  // namespace

WorkUnit measure_work_unit(GlobalIndex cells) {
  UnitBox const shape(cells);
  Real of_apply = std::numeric_limits<Real>::max(), of_triad = of_apply;
  {
    auto const x = make_values(shape.size(), 1.0), y = make_values(shape.size(), 2.0);
    Real const* const inside = x.get() + shape.first();
    auto const pass = [&] { apply(shape, inside, y.get() + shape.first()); };
    for (int trial = 0; trial < TRIALS; ++trial) {
      pass();  // brings the arrays into the caches that hold them
      of_apply = std::min(of_apply, seconds_of(pass));
    }
  }
  {
    LargeArray<Real> a(TRIAD_LENGTH, 1.0), b(TRIAD_LENGTH, 2.0), c(TRIAD_LENGTH, 3.0);
    for (int trial = 0; trial < TRIAD_TRIALS; ++trial)
      of_triad = std::min(of_triad, seconds_of([&] { triad(TRIAD_LENGTH, 0.5, a.data(), b.data(), c.data()); }));
  }
  Real const apply_seconds = of_apply * Real(cells) / Real(shape.cells());
  Real const triad_throughput = TRIAD_BYTES * Real(TRIAD_LENGTH) / of_triad;
  return {std::min(apply_seconds, APPLY_BYTES * Real(cells) / triad_throughput), apply_seconds, triad_throughput};
}

}  // namespace amrpic
