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
    std::copy_n(other.terms_.begin(), size_, terms_.begin());
    return *this;
  }

  void clear() { size_ = 0; }
  void add(Column const& column, Real value) {
    for (int k = 0; k < size_; ++k)
      if (terms_[std::size_t(k)].column == column) {
        terms_[std::size_t(k)].value += value;
        return;
      }
    append(column, value);
  }
  /// Add a term whose column is known to be new.
  void append(Column const& column, Real value) {
    if (size_ == capacity) throw std::logic_error("a stencil has more terms than a row holds");
    terms_[std::size_t(size_++)] = {column, value};
  }
  int size() const { return size_; }
  Column const& column(int k) const { return terms_[std::size_t(k)].column; }
  Real value(int k) const { return terms_[std::size_t(k)].value; }

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
    for (int k = 0; k < size_; ++k) terms_[std::size_t(k)].value *= weight;
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
  struct Term {
    Column column;
    Real value;
  };
  int size_ = 0;
  std::array<Term, capacity> terms_;
};

}  // namespace amrpic
