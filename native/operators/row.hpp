#pragma once

#include <algorithm>
#include <numeric>

#include "base/large_array.hpp"
#include "mesh/halo.hpp"
#include "operators/crs.hpp"
#include "stencil/linear_form.hpp"

namespace amrpic {

/// One row of an operator, in global cell numbers.
using Row = LinearForm<GlobalIndex>;

/// Write the same terms for each of `rows` rows. Copies of what is written already, twice as much each time, beat one
/// small copy per row.
inline void repeat(Real const* terms, std::size_t count, LocalIndex rows, Real* out) {
  std::size_t const all = count * std::size_t(rows);
  std::copy_n(terms, count, out);
  for (std::size_t done = count; done < all; done *= 2) std::copy_n(out, std::min(done, all - done), out + done);
}

/// Rows of cells next to each other along x.
struct RowRun {
  LocalIndex row, count;
};

/// Builds a Crs that is counted first and then filled in place. Single rows are given whole while counting; of runs of
/// rows that a loop can write, only the length is. Rows that are never named stay empty.
class CrsBuilder {
 public:
  explicit CrsBuilder(LocalIndex rows) { crs_.row_start.assign(std::size_t(rows) + 1, 0); }

  // ---- counting ----
  void put(LocalIndex row, Row const& values) {
    auto const& terms = values.terms();
    if (terms.empty()) return;
    crs_.row_start[std::size_t(row) + 1] = terms.size();
    single_.push_back({row, LocalIndex(terms.size())});
    terms_.insert(terms_.end(), terms.begin(), terms.end());
  }
  /// Runs come in ascending order.
  void put_run(RowRun const& run, std::size_t length) {
    runs_.push_back(run);
    std::fill_n(crs_.row_start.begin() + run.row + 1, run.count, length);
  }

  // ---- filling ----
  /// Make room and write the single rows.
  void start_filling(Halo const& numbering) {
    std::partial_sum(crs_.row_start.begin(), crs_.row_start.end(), crs_.row_start.begin());
    crs_.column.resize(crs_.row_start.back());
    crs_.value.resize(crs_.row_start.back());
    auto term = terms_.begin();
    for (auto const& [row, count] : single_) {
      std::size_t at = crs_.row_start[std::size_t(row)];
      for (LocalIndex k = 0; k < count; ++k, ++at, ++term) {
        crs_.column[at] = numbering.local(term->column);
        crs_.value[at] = term->value;
      }
    }
  }
  /// Call `f(first cell, number of rows, columns, values)` for each run in a box of the rows' level: the rows' terms
  /// are to be written there one after the other. Boxes come in ascending order.
  template <class F>
  void fill_runs(Box const& box, LocalIndex first_row, F&& f) {
    LocalIndex const nx = box.extent(0), ny = box.extent(1), end = first_row + LocalIndex(box.cells());
    for (; next_ < runs_.size() && runs_[next_].row < end; ++next_) {
      LocalIndex const row = runs_[next_].row, place = row - first_row;
      std::size_t const at = crs_.row_start[std::size_t(row)];
      f(Index3{box.lower[0] + place % nx, box.lower[1] + place / nx % ny, box.lower[2] + place / nx / ny},
        runs_[next_].count, crs_.column.data() + at, crs_.value.data() + at);
    }
  }
  Crs take() {
    crs_.finish();
    return std::move(crs_);
  }

 private:
  Crs crs_;
  LargeArray<RowRun> runs_;
  LargeArray<RowRun> single_;    ///< row and its number of terms
  LargeArray<Row::Term> terms_;  ///< of the single rows
  std::size_t next_ = 0;
};

}  // namespace amrpic
