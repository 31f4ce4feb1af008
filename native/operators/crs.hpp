#pragma once

#include <cstddef>
#include <vector>

#include "base/large_array.hpp"
#include "base/types.hpp"

namespace amrpic {

/// A sparse matrix by compressed rows over this rank's cells of a level; columns are places in [own cells | ghosts] of
/// a level. Rows of an operator that acts on few of them (at coarse-fine faces) are listed, so that applying it costs
/// only those.
struct Crs {
  LargeArray<std::size_t> row_start{0};  ///< rows + 1 values
  LargeArray<LocalIndex> column;
  LargeArray<Real> value;
  std::vector<LocalIndex> occupied;  ///< rows with entries, if they are less than half of all
  bool sparse_rows = false;          ///< whether `occupied` is used

  LocalIndex rows() const { return LocalIndex(row_start.size()) - 1; }
  std::size_t entries() const { return value.size(); }
  std::size_t bytes() const {
    return row_start.size() * sizeof(std::size_t) + entries() * (sizeof(LocalIndex) + sizeof(Real)) +
           occupied.size() * sizeof(LocalIndex);
  }

  /// Row times vector.
  Real dot(LocalIndex row, Real const* x) const {
    Real sum = 0;
    for (std::size_t k = row_start[row]; k < row_start[row + 1]; ++k) sum += value[k] * x[column[k]];
    return sum;
  }

  /// Make room for rows of so many entries, and list those that are occupied if they are few.
  void set_lengths(std::vector<LocalIndex> const& length) {
    row_start.resize(length.size() + 1);
    std::size_t entries = 0, filled = 0;
    for (std::size_t r = 0; r < length.size(); ++r) {
      row_start[r] = entries;
      entries += std::size_t(length[r]);
      filled += length[r] > 0;
    }
    row_start.back() = entries;
    column.resize(entries);
    value.resize(entries);
    sparse_rows = 2 * filled < row_start.size();
    if (!sparse_rows) return;
    occupied.reserve(filled);
    for (std::size_t r = 0; r < length.size(); ++r)
      if (length[r] > 0) occupied.push_back(LocalIndex(r));
  }

  /// Call f(row) for each row that has entries (or for all, where most have).
  template <class F>
  void for_each_row(F&& f) const {
    if (sparse_rows)
      for (LocalIndex r : occupied) f(r);
    else
      for (LocalIndex r = 0; r < rows(); ++r) f(r);
  }
};

/// y = A x.
inline void multiply(Crs const& a, Real const* x, Real* y) {
  for (LocalIndex r = 0; r < a.rows(); ++r) y[r] = a.dot(r, x);
}

/// y += scale A x.
inline void add_multiply(Real scale, Crs const& a, Real const* x, Real* y) {
  a.for_each_row([&](LocalIndex r) { y[r] += scale * a.dot(r, x); });
}

}  // namespace amrpic
