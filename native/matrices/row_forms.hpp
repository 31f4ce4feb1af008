// Rows of operators before they have columns: host code names the form of each row, and kernels fill the matrix.
#pragma once

#include <unordered_map>
#include <vector>

#include "base/large_array.hpp"
#include "matrices/form.hpp"
#include "matrices/row_kinds.hpp"
#include "matrices/sparse_matrix.hpp"

namespace amrpic {

constexpr LocalIndex no_form = -1;

/// Forms by number, equal ones once. Of a form's unknowns, which are all of one level, only the offsets count.
class FormTable {
 public:
  /// `no_form` for one without terms.
  LocalIndex number(Form const& form);

  std::vector<LocalIndex> const& starts() const { return start_; }  ///< where each form's terms start, and the end
  std::vector<std::array<std::int8_t, 3>> const& offsets() const { return offset_; }
  std::vector<Real> const& weights() const { return weight_; }

 private:
  bool equal(LocalIndex number, Form const& form) const;

  std::vector<LocalIndex> start_{0};
  std::vector<std::array<std::int8_t, 3>> offset_;
  std::vector<Real> weight_;
  std::unordered_multimap<std::size_t, LocalIndex> by_hash_;
};

/// The form of each row of an operator; rows that are never named stay empty.
class RowForms {
 public:
  explicit RowForms(LocalIndex rows) : form_(std::size_t(rows), no_form) {}
  void set(LocalIndex row, LocalIndex form) { form_[std::size_t(row)] = form; }
  void set(RowRun const& run, LocalIndex form) { std::fill_n(form_.begin() + run.row, run.count, form); }
  LargeArray<LocalIndex> const& values() const { return form_; }

 private:
  LargeArray<LocalIndex> form_;
};

/// Places of cells of a level near each box of another (or the same) level, in vectors of the former.
class NearPlaces {
 public:
  /// Those near the next box; none if the region is empty.
  void add(ArrayOnBox<LocalIndex> const& places);

  /// The place of cell (i, j, k) near a box is values[origin + i + pitch_y j + pitch_z k].
  struct Region {
    std::int64_t origin;
    int pitch_y, pitch_z;
  };
  std::vector<Region> const& regions() const { return region_; }
  LargeArray<LocalIndex> const& values() const { return values_; }

 private:
  std::vector<Region> region_;
  LargeArray<LocalIndex> values_;
};

/// The cell that offsets count from: that of the row, its parent, or its first child; factors on and divisors of its
/// indices.
struct Anchor {
  Index3 times{1, 1, 1}, over{1, 1, 1};
};

/// An operator of rows in the cells of `rows` with columns among those of `columns`. Kernels count and fill it: one
/// team for each row of cells along x. Throws std::logic_error for a form that reaches for a cell without a place.
/// Collective.
SparseMatrix filled(FormTable const& forms, RowForms const& row_forms, NearPlaces const& places, Anchor const& anchor,
                    LevelCells const& rows, LevelCells const& columns);

}  // namespace amrpic
