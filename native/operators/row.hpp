#pragma once

#include <algorithm>
#include <array>
#include <stdexcept>

#include "mesh/exchange.hpp"
#include "mesh/window.hpp"
#include "operators/crs.hpp"

namespace amrpic {

/// One row of an operator under way: terms in global cell numbers, equal columns added up, in order of first
/// appearance.
class Row {
 public:
  void clear() { size_ = 0; }
  void add(GlobalIndex column, Real value) {
    if (column == no_cell) throw std::logic_error("a stencil reached for a cell that does not exist");
    for (int k = 0; k < size_; ++k)
      if (columns_[k] == column) {
        values_[k] += value;
        return;
      }
    if (size_ == capacity) throw std::logic_error("a stencil has more terms than a row holds");
    columns_[size_] = column;
    values_[size_++] = value;
  }
  /// Add a term whose column is known to be new.
  void append(GlobalIndex column, Real value) {
    columns_[size_] = column;
    values_[size_++] = value;
  }
  int size() const { return size_; }
  GlobalIndex column(int k) const { return columns_[k]; }
  Real value(int k) const { return values_[k]; }

 private:
  static constexpr int capacity = 160;  // 7 + 6 faces x 25 cells of the plane
  int size_ = 0;
  std::array<GlobalIndex, capacity> columns_;
  std::array<Real, capacity> values_;
};

/// Builds a Crs in two passes over the same rows: the first counts the terms and collects the cells of other ranks that
/// they name, the second writes into arrays of the final size. Rows come in order.
class CrsBuilder {
 public:
  CrsBuilder(LocalIndex rows, Level const& columns) : columns_(&columns) {
    crs_.row_start.reserve(std::size_t(rows) + 1);
  }

  void put(Row const& row) {
    if (!numbering_) {
      for (int k = 0; k < row.size(); ++k)
        if (!columns_->owns(row.column(k))) remote_.push_back(row.column(k));
      crs_.row_start.push_back(crs_.row_start.back() + std::size_t(row.size()));
      return;
    }
    for (int k = 0; k < row.size(); ++k, ++at_) {
      crs_.column[at_] = numbering_->local(row.column(k));
      crs_.value[at_] = row.value(k);
    }
  }

  /// A row whose columns are own cells, given by their places.
  template <std::size_t n>
  void put_own(std::array<LocalIndex, n> const& columns, std::array<Real, n> const& values) {
    if (!numbering_) {
      crs_.row_start.push_back(crs_.row_start.back() + n);
      return;
    }
    std::copy(columns.begin(), columns.end(), crs_.column.begin() + std::ptrdiff_t(at_));
    std::copy(values.begin(), values.end(), crs_.value.begin() + std::ptrdiff_t(at_));
    at_ += n;
  }
  void put_empty() {
    if (!numbering_) crs_.row_start.push_back(crs_.row_start.back());
  }

  /// Cells of other ranks that the rows name, with repetitions; to be added to those of others who share the numbering.
  std::vector<GlobalIndex> const& remote() const { return remote_; }

  void start_filling(Exchange const& numbering) {
    numbering_ = &numbering;
    std::vector<GlobalIndex>().swap(remote_);
    crs_.column.resize(crs_.row_start.back());
    crs_.value.resize(crs_.row_start.back());
  }

  Crs take() {
    crs_.finish();
    return std::move(crs_);
  }

 private:
  Level const* columns_;
  Crs crs_;
  std::vector<GlobalIndex> remote_;
  Exchange const* numbering_ = nullptr;
  std::size_t at_ = 0;
};

}  // namespace amrpic
