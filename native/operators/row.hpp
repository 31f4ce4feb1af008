#pragma once

#include <algorithm>
#include <utility>
#include <vector>

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
  explicit CrsBuilder(LocalIndex rows) : length_(std::size_t(rows), 0) {}

  // ---- counting ----
  void put(LocalIndex row, Row const& values) {
    auto const& terms = values.terms();
    if (terms.empty()) return;
    length_[std::size_t(row)] = LocalIndex(terms.size());
    single_.push_back(row);
    terms_.insert(terms_.end(), terms.begin(), terms.end());
  }
  /// Runs come in ascending order.
  void put_run(RowRun const& run, std::size_t length) {
    runs_.push_back(run);
    std::fill_n(length_.begin() + run.row, run.count, LocalIndex(length));
  }

  // ---- filling ----
  /// Make room and write the single rows.
  void start_filling(Halo const& numbering) {
    crs_.set_lengths(length_);
    auto term = terms_.begin();
    for (LocalIndex row : single_)
      for (std::size_t at = crs_.row_start[row]; at < crs_.row_start[row + 1]; ++at, ++term) {
        crs_.column[at] = numbering.local(term->column);
        crs_.value[at] = term->value;
      }
    length_ = {}, single_ = {}, terms_ = {};  // their memory may serve the next builder
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
  Crs take() { return std::move(crs_); }

 private:
  Crs crs_;
  std::vector<LocalIndex> length_;  ///< of each row
  std::vector<RowRun> runs_;
  std::vector<LocalIndex> single_;  ///< rows
  std::vector<Row::Term> terms_;    ///< of the single rows
  std::size_t next_ = 0;
};

}  // namespace amrpic
