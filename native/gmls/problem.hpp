// Generalized moving least squares: weights of samples near targets that give the targets exactly for all polynomials
// of a space. Wendland, Scattered Data Approximation (2004), chapter 4; Compadre Toolkit, doi 10.11578/dc.20190411.1.
#pragma once

#include <cstdint>
#include <vector>

#include "gmls/functionals.hpp"
#include "gmls/weights.hpp"

namespace amrpic::gmls {

/// The arrays belong to the caller.
struct Problem {
  Problem(int dimension, int order) : dimension(dimension), monomials(dimension, order) {}

  int dimension;
  Monomials monomials;
  int components = 1;       ///< of the polynomials: more for vectors
  std::vector<Real> basis;  ///< of the space, (full, unknowns): coefficients of the monomials; none: all monomials
  Weight weight;
  std::array<Real, 3> aspect{1, 1, 1};  ///< the reach along each axis, over the reach
  std::size_t count = 0;                ///< of targets
  Real const* targets = nullptr;        ///< (count, dimension)
  Real const* reach = nullptr;          ///< (count)
  std::int64_t const* start = nullptr;  ///< (count + 1): where each target's neighbours begin
  LocalIndex const* index = nullptr;    ///< samples
  Real const* sites = nullptr;          ///< (samples, dimension): where samples lie for the weight
  Functionals samples;                  ///< one row; without terms: values at the sites
  Functionals wanted, exact;            ///< places relative to the target

  int full() const { return components * monomials.count(); }
  int unknowns() const { return basis.empty() ? full() : int(basis.size()) / full(); }
  bool samples_are_points() const { return samples.terms.empty(); }
  int neighbours(std::size_t target) const { return int(start[target + 1] - start[target]); }
};

/// How weights were found: less_rank, by normal equations without columns that depend on others; orthogonal, by QR of
/// least norm. Or why not: undetermined; dependent, exact rows that depend on each other.
enum class Path : std::int8_t { normal_equations, less_rank, orthogonal, undetermined, dependent };

/// What is found, in arrays of the caller.
struct Stencils {
  Real* weight;        ///< (neighbours of all targets, wanted)
  Real* exact_weight;  ///< (targets, exact, wanted)
  Path* path;          ///< (targets)
  Real* pivot;         ///< least pivot over its diagonal entry
  Real* residual;      ///< largest error of reproduction, over the larger of |τ| and the sum of |α λ|
  Real* sum;           ///< of |α λ| over the largest |τ|; of values at points: of |α|
};

/// The stencils of all targets; the path of those that the samples do not determine within `residual_bound` and
/// `sum_bound` says so, and their weights are not to be used. Either with all lanes of the processor or, slower, target
/// by target; both agree to rounding.
void solve(Problem const& problem, Real residual_bound, Real sum_bound, bool portable, Stencils const& to);

/// Of one target: weights are root_weight * z, where Qᵀ z = τ.
struct Equations {
  std::vector<Real> rows, root_weight, tau;  ///< Q (samples, unknowns), (samples), τ (unknowns, wanted)
};

Equations equations(Problem const& problem, std::size_t target);

}  // namespace amrpic::gmls
