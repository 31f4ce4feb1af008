#include "material/ogden.hpp"

#include <cmath>

namespace amrpic::material {

namespace {

/// Logarithms of principal stretches, and directions: of the present configuration from FF', of the initial one from
/// F'F.
struct Stretches {
  std::array<Real, 3> log;
  Tensor direction;

  explicit Stretches(Tensor const& squares) {
    auto const eigen = eigen_of(squares);
    for (std::size_t i = 0; i < 3; ++i) log[i] = std::log(eigen.value[i]) / 2;
    direction = eigen.vector;
  }
  Real log_j() const { return log[0] + log[1] + log[2]; }
};

/// A principal Kirchhoff stress without its part of lambda.
Real along(std::vector<Ogden::Term> const& terms, Real log) {
  Real out = 0;
  for (auto const& term : terms) out += term.mu * std::expm1(term.alpha * log);
  return out;
}

/// Its derivative to the logarithm of its stretch.
Real slope_along(std::vector<Ogden::Term> const& terms, Real log) {
  Real out = 0;
  for (auto const& term : terms) out += term.mu * term.alpha * std::exp(term.alpha * log);
  return out;
}

/// Difference of two such stresses over that of squares of their stretches. Written in the ratio of both stretches, it
/// needs no difference of nearly equal numbers, and has its limit where they are equal.
Real divided_difference(std::vector<Ogden::Term> const& terms, Real log, Real other) {
  Real const gap = other - log;
  Real out = 0;
  for (auto const& term : terms) {
    Real const ratio = gap == 0 ? term.alpha / 2 : std::expm1(term.alpha * gap) / std::expm1(2 * gap);
    out += term.mu * std::exp((term.alpha - 2) * log) * ratio;
  }
  return out;
}

}  // namespace

Real Ogden::energy(Tensor const& f) const {
  Stretches const stretches(product(transposed(f), f));
  Real out = lambda / 2 * stretches.log_j() * stretches.log_j();
  for (auto const& term : terms) {
    for (Real log : stretches.log) out += term.mu / term.alpha * std::expm1(term.alpha * log);
    out -= term.mu * stretches.log_j();
  }
  return out;
}

Tensor Ogden::stress(Tensor const& f) const {
  Stretches const stretches(product(f, transposed(f)));
  Tensor out{};
  for (std::size_t i = 0; i < 3; ++i) out[i][i] = along(terms, stretches.log[i]) + lambda * stretches.log_j();
  return product(stretches.direction, product(out, transposed(stretches.direction)));
}

PrincipalModuli Ogden::moduli(Tensor const& f) const {
  Stretches const stretches(product(f, transposed(f)));
  PrincipalModuli out;
  out.direction = stretches.direction;
  std::array<Real, 3> stress, square;
  for (std::size_t i = 0; i < 3; ++i) {
    stress[i] = along(terms, stretches.log[i]) + lambda * stretches.log_j();
    square[i] = std::exp(2 * stretches.log[i]);
  }
  for_each_entry([&](std::size_t i, std::size_t j) {
    out.along[i][j] = lambda + (i == j ? slope_along(terms, stretches.log[i]) - 2 * stress[i] : 0);
    if (i < j)
      out.shear[3 - i - j] = divided_difference(terms, stretches.log[i], stretches.log[j]) * (square[i] + square[j]) -
                             stress[i] - stress[j];
  });
  return out;
}

Tensor Ogden::change_initially(Tensor const& f, Tensor const& change) const {
  // P = F S, and the second stress S has the directions of C = F'F.
  Stretches const stretches(product(transposed(f), f));
  Tensor const& n = stretches.direction;
  Tensor const change_of_c = product(transposed(change), f);
  Tensor const turned = product(transposed(n), product(sum(change_of_c, 1, transposed(change_of_c)), n));
  std::array<Real, 3> stress, square;
  for (std::size_t i = 0; i < 3; ++i) {
    square[i] = std::exp(2 * stretches.log[i]);
    stress[i] = (along(terms, stretches.log[i]) + lambda * stretches.log_j()) / square[i];
  }
  Tensor second{}, change_of_second{};
  for_each_entry([&](std::size_t i, std::size_t j) {
    if (i != j) {  // (S_i - S_j) / (C_i - C_j), with S_i = tau_i / C_i
      Real const by = (divided_difference(terms, stretches.log[i], stretches.log[j]) - stress[i]) / square[j];
      change_of_second[i][j] = by * turned[i][j];
      return;
    }
    second[i][i] = stress[i];
    for (std::size_t k = 0; k < 3; ++k) {
      Real slope = lambda + (i == k ? slope_along(terms, stretches.log[i]) - 2 * square[i] * stress[i] : 0);
      change_of_second[i][i] += slope / (2 * square[i] * square[k]) * turned[k][k];
    }
  });
  auto const back = [&](Tensor const& a) { return product(n, product(a, transposed(n))); };
  return sum(product(change, back(second)), 1, product(f, back(change_of_second)));
}

}  // namespace amrpic::material
