#pragma once

#include <functional>
#include <vector>

#include "base/communicator.hpp"

namespace amrpic {

/// Chebyshev's iteration with the diagonal, for a symmetric positive definite operator: a smoother that is symmetric
/// itself. It damps the upper part of the spectrum of D⁻¹A.
class Chebyshev {
 public:
  using Apply = std::function<void(std::vector<Real> const&, std::vector<Real>&)>;

  /// `inverse`: of the diagonal, zero where unknowns are fixed, which then stay as they are. `start`: a vector with
  /// parts of all wave lengths, from which the largest eigenvalue is estimated by ten steps of Lanczos. `lower_end`:
  /// where the damped part begins, of that estimate. Collective.
  Chebyshev(Communicator const& comm, Apply apply, std::vector<Real> inverse, std::vector<Real> start,
            Real lower_end = 0.1);

  /// Bring x nearer to the solution of A x = b; `from_zero`: x is zero, whatever it holds. Collective.
  void smooth(std::vector<Real> const& b, std::vector<Real>& x, bool from_zero);

  Real largest_eigenvalue() const { return largest_; }

 private:
  Apply apply_;
  std::vector<Real> inverse_, product_, change_;
  Real lower_end_, largest_ = 0;
};

/// The largest eigenvalue of a symmetric matrix with three diagonals.
Real largest_of_tridiagonal(std::vector<Real> const& diagonal, std::vector<Real> const& beside);

}  // namespace amrpic
