#pragma once

#include <utility>
#include <vector>

#include "base/types.hpp"

namespace amrpic {

/// A weighted sum of unknowns: what a formula gives when its values are the unknowns themselves, a row of an operator.
/// Equal columns are added up, in the order of their first appearance.
template <class Column>
class LinearForm {
 public:
  struct Term {
    Column column;
    Real value;
    // For `emplace_back`: of a term that is made first and then copied, two stores would be read by one load, which
    // waits.
    Term(Column const& c, Real v) : column(c), value(v) {}
  };

  LinearForm() = default;
  LinearForm(Column const& unknown, Real weight) { append(unknown, weight); }

  void clear() { terms_.clear(); }
  void add(Column const& column, Real value) {
    for (Term& term : terms_)
      if (term.column == column) {
        term.value += value;
        return;
      }
    append(column, value);
  }
  /// Add a term whose column is known to be new.
  void append(Column const& column, Real value) { terms_.emplace_back(column, value); }
  std::vector<Term> const& terms() const { return terms_; }

  LinearForm& operator+=(LinearForm const& other) {
    for (Term const& term : other.terms_) add(term.column, term.value);
    return *this;
  }
  LinearForm& operator-=(LinearForm const& other) {
    for (Term const& term : other.terms_) add(term.column, -term.value);
    return *this;
  }
  /// Of a weight of zero nothing is left, not even columns.
  LinearForm& operator*=(Real weight) {
    if (weight == 0) clear();
    for (Term& term : terms_) term.value *= weight;
    return *this;
  }
  friend LinearForm operator+(LinearForm a, LinearForm const& b) { return std::move(a += b); }
  friend LinearForm operator-(LinearForm a, LinearForm const& b) { return std::move(a -= b); }
  friend LinearForm operator*(Real weight, LinearForm form) { return std::move(form *= weight); }

 private:
  std::vector<Term> terms_;
};

}  // namespace amrpic
