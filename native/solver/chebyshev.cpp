#include "solver/chebyshev.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

namespace amrpic {

namespace {

constexpr int sweeps = 3;
constexpr int lanczos_steps = 10;
constexpr Real upper_end = 1.1;  ///< of what is damped, in parts of the estimate, which is from below

}  // namespace

Real largest_of_tridiagonal(std::vector<Real> const& diagonal, std::vector<Real> const& beside) {
  std::size_t const n = diagonal.size();
  Real low = diagonal[0], high = diagonal[0];
  for (std::size_t i = 0; i < n; ++i) {  // Gershgorin
    Real const reach = (i > 0 ? std::abs(beside[i - 1]) : 0) + (i + 1 < n ? std::abs(beside[i]) : 0);
    low = std::max(low, diagonal[i]), high = std::max(high, diagonal[i] + reach);
  }
  auto const lies_above = [&](Real x) {  // by the signs of pivots of T - x: all are negative beyond the largest one
    Real pivot = -1;
    for (std::size_t i = 0; i < n; ++i) {
      pivot = diagonal[i] - x - (i > 0 ? beside[i - 1] * beside[i - 1] / pivot : 0);
      if (pivot >= 0) return false;
    }
    return true;
  };
  for (int step = 0; step < 60; ++step) (lies_above((low + high) / 2) ? high : low) = (low + high) / 2;
  return high;
}

Chebyshev::Apply by_diagonal(std::vector<Real> inverse) {
  return [inverse = std::move(inverse)](std::vector<Real> const& r, std::vector<Real>& z) {
    for (std::size_t i = 0; i < r.size(); ++i) z[i] = inverse[i] * r[i];
  };
}

Chebyshev::Chebyshev(Communicator const& comm, Apply apply, Apply precondition, std::vector<Real> start, Real lower_end)
    : apply_(std::move(apply)),
      precondition_(std::move(precondition)),
      residual_(start.size()),
      correction_(start.size()),
      change_(start.size()),
      lower_end_(lower_end) {
  // Conjugate gradients with S make Lanczos' matrix on their way.
  std::size_t const n = start.size();
  std::vector<Real> r = std::move(start), p(n, 0), diagonal, beside;
  std::vector<Real>&z = correction_, &product = residual_;
  Real before = 0, step_before = 1;
  for (int step = 0; step < lanczos_steps; ++step) {
    std::array<Real, 1> rz{};
    precondition_(r, z);
    for (std::size_t i = 0; i < n; ++i) rz[0] += r[i] * z[i];
    comm.sum_each(rz);
    if (!(rz[0] > 0)) break;
    Real const kept = step == 0 ? 0 : rz[0] / before;
    for (std::size_t i = 0; i < n; ++i) p[i] = z[i] + kept * p[i];
    apply_(p, product);
    Real curvature = 0;
    for (std::size_t i = 0; i < n; ++i) curvature += p[i] * product[i];
    curvature = comm.sum(curvature);
    if (!(curvature > 0)) break;
    Real const length = rz[0] / curvature;
    if (step > 0) beside.push_back(std::sqrt(kept) / step_before);
    diagonal.push_back(1 / length + (step > 0 ? kept / step_before : 0));
    for (std::size_t i = 0; i < n; ++i) r[i] -= length * product[i];
    before = rz[0], step_before = length;
  }
  largest_ = diagonal.empty() ? 1 : largest_of_tridiagonal(diagonal, beside);
}

std::vector<Real>& Chebyshev::residual(std::vector<Real> const& b, std::vector<Real> const& x) {
  apply_(x, residual_);
  for (std::size_t i = 0; i < x.size(); ++i) residual_[i] = b[i] - residual_[i];
  return residual_;
}

void Chebyshev::smooth(std::vector<Real> const& b, std::vector<Real>& x, bool from_zero) {
  Real const middle = (upper_end + lower_end_) / 2 * largest_, half = (upper_end - lower_end_) / 2 * largest_;
  Real const sigma = middle / half;
  Real rho = 1 / sigma;
  for (int sweep = 0; sweep < sweeps; ++sweep) {
    bool const first = sweep == 0, zero = first && from_zero;
    precondition_(zero ? b : residual(b, x), correction_);
    Real const next = first ? rho : 1 / (2 * sigma - rho);
    Real const keep = first ? 0 : next * rho, take = first ? 1 / middle : 2 * next / half;
    for (std::size_t i = 0; i < x.size(); ++i) {
      change_[i] = (first ? 0 : keep * change_[i]) + take * correction_[i];
      x[i] = (zero ? 0 : x[i]) + change_[i];
    }
    rho = next;
  }
}

}  // namespace amrpic
