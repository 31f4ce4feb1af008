#pragma once

#include <functional>
#include <vector>

#include "base/communicator.hpp"

namespace amrpic {

/// Chebyshev's iteration for a symmetric positive definite operator A with one that is easy to apply, S, such as the
/// inverse of its diagonal: a smoother that is symmetric itself. It damps the upper part of the spectrum of S A.
class Chebyshev {
 public:
  using Apply = std::function<void(std::vector<Real> const&, std::vector<Real>&)>;

  /// `apply(x, y)`: y = A x. `precondition(r, z)`: z = S r, symmetric and positive definite, zero where unknowns are
  /// fixed, which then stay as they are. `start`: a vector with parts of all wave lengths, from which the largest
  /// eigenvalue is estimated by ten steps of Lanczos. `lower_end`: where the damped part begins, of that estimate.
  /// Collective.
  Chebyshev(Communicator const& comm, Apply apply, Apply precondition, std::vector<Real> start, Real lower_end = 0.1);

  /// Bring x nearer to the solution of A x = b; `from_zero`: x is zero, whatever it holds. Collective.
  void smooth(std::vector<Real> const& b, std::vector<Real>& x, bool from_zero);

  /// b - A x, to be read or changed until the next call of this. Collective.
  std::vector<Real>& residual(std::vector<Real> const& b, std::vector<Real> const& x);

  /// Take another S from here on, near the one before: the eigenvalue stays.
  void precondition_by(Apply precondition) { precondition_ = std::move(precondition); }

  Real largest_eigenvalue() const { return largest_; }

 private:
  Apply apply_, precondition_;
  std::vector<Real> residual_, correction_, change_;
  Real lower_end_, largest_ = 0;
};

/// z = r / D, by the inverse of a diagonal.
Chebyshev::Apply by_diagonal(std::vector<Real> inverse);

/// The largest eigenvalue of a symmetric matrix with three diagonals.
Real largest_of_tridiagonal(std::vector<Real> const& diagonal, std::vector<Real> const& beside);

}  // namespace amrpic
