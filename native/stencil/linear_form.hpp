#pragma once

#include <algorithm>
#include <array>
#include <stdexcept>
#include <utility>

#include "base/types.hpp"

namespace amrpic {

/// A weighted sum of unknowns: what a formula gives when its values are the unknowns themselves, a row of an operator.
/// Equal columns are added up, in the order of their first appearance.
template <class Column>
class LinearForm {
 public:
  LinearForm() = default;
  LinearForm(Column const& unknown, Real weight) { append(unknown, weight); }
  LinearForm(LinearForm const& other) { *this = other; }
  LinearForm& operator=(LinearForm const& other) {
    size_ = other.size_;
    std::copy_n(other.columns_.begin(), size_, columns_.begin());
    std::copy_n(other.values_.begin(), size_, values_.begin());
    return *this;
  }

  void clear() { size_ = 0; }
  void add(Column const& column, Real value) {
    for (int k = 0; k < size_; ++k)
      if (columns_[std::size_t(k)] == column) {
        values_[std::size_t(k)] += value;
        return;
      }
    append(column, value);
  }
  /// Add a term whose column is known to be new.
  void append(Column const& column, Real value) {
    if (size_ == capacity) throw std::logic_error("a stencil has more terms than a row holds");
    columns_[std::size_t(size_)] = column;
    values_[std::size_t(size_++)] = value;
  }
  int size() const { return size_; }
  Column const& column(int k) const { return columns_[std::size_t(k)]; }
  Real value(int k) const { return values_[std::size_t(k)]; }

  LinearForm& operator+=(LinearForm const& other) {
    for (int k = 0; k < other.size_; ++k) add(other.column(k), other.value(k));
    return *this;
  }
  LinearForm& operator-=(LinearForm const& other) {
    for (int k = 0; k < other.size_; ++k) add(other.column(k), -other.value(k));
    return *this;
  }
  /// Of a weight of zero nothing is left, not even columns.
  LinearForm& operator*=(Real weight) {
    if (weight == 0) size_ = 0;
    for (int k = 0; k < size_; ++k) values_[std::size_t(k)] *= weight;
    return *this;
  }
  // A form is large: what an expression has made already takes the next operation in place.
  friend LinearForm operator+(LinearForm const& a, LinearForm const& b) { return LinearForm(a) + b; }
  friend LinearForm&& operator+(LinearForm&& a, LinearForm const& b) { return std::move(a += b); }
  friend LinearForm operator-(LinearForm const& a, LinearForm const& b) { return LinearForm(a) - b; }
  friend LinearForm&& operator-(LinearForm&& a, LinearForm const& b) { return std::move(a -= b); }
  friend LinearForm operator*(Real weight, LinearForm const& form) { return weight * LinearForm(form); }
  friend LinearForm&& operator*(Real weight, LinearForm&& form) { return std::move(form *= weight); }

 private:
  static constexpr int capacity = 160;  // 7 + 6 faces x 25 cells of the plane
  int size_ = 0;
  std::array<Column, capacity> columns_;
  std::array<Real, capacity> values_;
};

}  // namespace amrpic
