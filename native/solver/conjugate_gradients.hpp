#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "base/communicator.hpp"

namespace amrpic {

/// How a solve by conjugate gradients went.
struct GradientsReport {
  std::vector<Real> residuals;  ///< L2 norms, the first one before any iteration
  /// A direction was met along which the operator is not positive: x has gone along it, downhill, by as much as if the
  /// curvature had the other sign, though by no longer step than those before.
  bool curved_down = false;
};

/// Reduce the residual r = f - A x of a symmetric positive definite A to `tolerance` times what it is, adding to x.
/// `apply(p, q)`: q = A p; `precondition(r, z)`: z near the solution of A z = r, symmetric and positive definite.
/// Collective, three reductions an iteration.
template <class Apply, class Precondition>
GradientsReport conjugate_gradients(Communicator const& comm, Apply&& apply, Precondition&& precondition,
                                    std::vector<Real>& r, std::vector<Real>& x, Real tolerance, int most_iterations) {
  std::size_t const n = r.size();
  auto const dot = [&](std::vector<Real> const& a, std::vector<Real> const& b) {
    Real sum = 0;
    for (std::size_t i = 0; i < n; ++i) sum += a[i] * b[i];
    return comm.sum(sum);
  };
  GradientsReport out;
  std::vector<Real> z(n), p(n, 0), q(n);
  Real before = 0, longest = 0;
  for (int iteration = 0;; ++iteration) {
    out.residuals.push_back(std::sqrt(dot(r, r)));
    if (out.residuals.back() <= tolerance * out.residuals.front() || iteration == most_iterations) return out;
    precondition(r, z);
    Real const rz = dot(r, z);
    Real const kept = iteration == 0 ? 0 : rz / before;
    for (std::size_t i = 0; i < n; ++i) p[i] = z[i] + kept * p[i];
    apply(p, q);
    Real const curvature = dot(p, q), step = rz / std::abs(curvature);
    if (!(curvature > 0)) {
      out.curved_down = true;
      Real const down = iteration == 0 ? step : std::min(step, longest);
      if (curvature < 0)
        for (std::size_t i = 0; i < n; ++i) x[i] += down * p[i];
      return out;
    }
    longest = std::max(longest, step);
    for (std::size_t i = 0; i < n; ++i) x[i] += step * p[i], r[i] -= step * q[i];
    before = rz;
  }
}

}  // namespace amrpic
