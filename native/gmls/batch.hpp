// As many problems as the processor has lanes, all in step: one text for vectors and for single numbers.
#pragma once

#include <algorithm>
#include <limits>
#include <vector>

#include "gmls/pivoted_qr.hpp"
#include "gmls/problem.hpp"

namespace amrpic::gmls {

#ifdef AMRPIC_AVX512
constexpr int lanes_of_processor = 8;
#else
constexpr int lanes_of_processor = 4;
#endif
typedef Real ProcessorLanes __attribute__((vector_size(8 * lanes_of_processor)));

constexpr Real pivot_tolerance = 1e-8;  ///< a pivot over its diagonal entry, below which the equations are not trusted

/// c(a, b) += sum over k < count of x(k, a) y(k, b), for two a and two b; steps from k to k and from a to a, b to b.
template <class V>
inline void add_products(int count, V const* x, std::ptrdiff_t x_next, std::ptrdiff_t x_beside, V const* y,
                         std::ptrdiff_t y_next, std::ptrdiff_t y_beside, V* c, std::ptrdiff_t c_step) {
  V c00 = c[0], c01 = c[1], c10 = c[c_step], c11 = c[c_step + 1];
  for (int k = 0; k < count; ++k, x += x_next, y += y_next) {
    V const x0 = x[0], x1 = x[x_beside], y0 = y[0], y1 = y[y_beside];
    c00 += x0 * y0, c01 += x0 * y1, c10 += x1 * y0, c11 += x1 * y1;
  }
  c[0] = c00, c[1] = c01, c[c_step] = c10, c[c_step + 1] = c11;
}

/// Weighted least squares with the targets first. With Q = √W P, of rows √w λ(p), the weights are α = √W z, where
/// z = Q y and QᵀQ y = τ; then Qᵀz = τ: polynomials of the space are reproduced.
///
/// Exact rows C are eliminated first: with Householder's H, H Cᵀ = [R; 0], the polynomials that C does not see are the
/// last columns of Q Hᵀ, and the weights β of the data of C follow from R β = (H (τ - Pᵀα)) in the first columns.
///
/// Q, τ, z, y have even numbers of rows and columns, the last one zero where there is one too many.
template <class V>
class Batch {
 public:
  explicit Batch(Problem const& problem)
      : problem_(problem),
        targets_(problem.wanted.rows),
        wide_(even(targets_)),
        fixed_(problem.exact.rows),
        free_(problem.unknowns() - fixed_),
        n_(even(free_)) {}

  /// The stencils of some targets, by normal equations.
  void solve(Each<V> const& of, Stencils const& to) {
    fill(of);
    form();
    factor();
    std::copy(tau_.begin(), tau_.end(), residual_.begin());
    std::fill(y_.begin(), y_.end(), V{});
    for (int pass = 0; pass < 2; ++pass) {  // the second one refines
      add_solution_of_residual();
      reproduce();
    }
    write(of, to, Path::normal_equations);
  }

  /// The same, of one target, by orthogonal factors of least norm: for problems that the equations do not determine.
  void solve_by_factors(Each<V> const& of, Stencils const& to) {
    Equations const e = equations(of);
    std::vector<Real> z(std::size_t(m_ * targets_));
    least_norm(int(e.root_weight.size()), free_, targets_, e.rows.data(), e.tau.data(), z.data());
    std::fill(z_.begin(), z_.end(), V{});
    for (int j = 0; j < int(e.root_weight.size()); ++j)
      for (int t = 0; t < targets_; ++t) z_[at(j, wide_, t)] = z[at(j, targets_, t)];
    find_residual();
    write(of, to, Path::orthogonal);
  }

  /// Of one target.
  Equations equations(Each<V> const& of) {
    fill(of);
    Equations out;
    for (int j = 0; j < problem_.neighbours(of[0]); ++j) {
      out.rows.insert(out.rows.end(), &q_[at(j, n_, 0)], &q_[at(j, n_, 0)] + free_);
      out.root_weight.push_back(root_weight_[std::size_t(j)]);
    }
    for (int i = 0; i < free_; ++i)
      out.tau.insert(out.tau.end(), &tau_[at(i, wide_, 0)], &tau_[at(i, wide_, 0)] + targets_);
    return out;
  }

 private:
  static int even(int n) { return n + n % 2; }
  static std::size_t at(int row, int columns, int column) {
    return std::size_t(row) * std::size_t(columns) + std::size_t(column);
  }

  // ---- the problems of the lanes ----

  /// Rows of samples, weights, right-hand sides.
  void fill(Each<V> const& of) {
    Problem const& p = problem_;
    int const unknowns = p.unknowns();
    std::array<V, 3> origin{}, inverse{};
    V const reach = gathered<V>(p.reach, of);
    for (int d = 0; d < p.dimension; ++d) {
      auto place = of;
      for (auto& l : place) l = l * std::size_t(p.dimension) + std::size_t(d);
      origin[std::size_t(d)] = gathered<V>(p.targets, place);
      inverse[std::size_t(d)] = 1 / (reach * p.aspect[std::size_t(d)]);
    }
    int longest = 0;
    for (auto t : of) longest = std::max(longest, p.neighbours(t));
    m_ = even(longest);
    resize(unknowns);

    std::array<V, 3> const zero{};
    row_.resize(std::size_t(std::max({p.wanted.rows, fixed_, 1}) * p.full()));
    reduced_.resize(std::size_t(unknowns));
    if (fixed_ > 0) {
      p.exact.evaluate(p.monomials, p.components, of, zero, inverse, row_.data());
      for (int c = 0; c < fixed_; ++c) add_reflector(row_.data() + c * p.full(), c);
    }
    p.wanted.evaluate(p.monomials, p.components, of, zero, inverse, row_.data());
    for (int t = 0; t < targets_; ++t) {
      reduce(row_.data() + t * p.full());
      for (int i = 0; i < fixed_; ++i) fixed_tau_[at(i, wide_, t)] = reduced_[std::size_t(i)];
      for (int i = 0; i < free_; ++i) tau_[at(i, wide_, t)] = reduced_[std::size_t(fixed_ + i)];
    }
    for (int j = 0; j < longest; ++j) fill_row(j, of, origin, inverse);
  }

  void resize(int unknowns) {
    auto const zeros = [](std::vector<V>& values, int count) { values.assign(std::size_t(count), V{}); };
    q_.resize(std::size_t(m_ * n_)), z_.resize(std::size_t(m_ * wide_));
    for (int j = 0; j < m_; ++j) q_[at(j, n_, n_ - 1)] = V{};
    if (m_ > 0) std::fill(&q_[at(m_ - 1, n_, 0)], &q_[at(m_ - 1, n_, 0)] + n_, V{});
    zeros(root_weight_, m_), zeros(largest_, m_), zeros(fixed_q_, m_ * fixed_);
    zeros(tau_, n_ * wide_), zeros(y_, n_ * wide_), zeros(residual_, n_ * wide_), zeros(fixed_tau_, fixed_ * wide_);
    zeros(matrix_, n_ * n_), zeros(inverse_root_, n_);
    zeros(reflector_, fixed_ * unknowns), zeros(upper_, fixed_ * fixed_);
    independent_ = V{} + 1;
  }

  /// Row j of Q, in all lanes that have so many neighbours.
  void fill_row(int j, Each<V> const& of, std::array<V, 3> const& origin, std::array<V, 3> const& inverse) {
    Problem const& p = problem_;
    Each<V> sample, place;
    std::array<Real, std::size_t(width<V>)> there;
    for (std::size_t l = 0; l < of.size(); ++l) {
      int const count = p.neighbours(of[l]);
      there[l] = j < count ? 1 : 0;
      sample[l] = std::size_t(p.index[p.start[of[l]] + std::min(j, count - 1)]);
    }
    std::array<V, 3> u{};
    V square{};
    for (int d = 0; d < p.dimension; ++d) {
      for (std::size_t l = 0; l < of.size(); ++l) place[l] = sample[l] * std::size_t(p.dimension) + std::size_t(d);
      u[std::size_t(d)] = (gathered<V>(p.sites, place) - origin[std::size_t(d)]) * inverse[std::size_t(d)];
      square += u[std::size_t(d)] * u[std::size_t(d)];
    }
    V const weight = root_of_weight(p.weight, square) * load<V>(there.data());
    root_weight_[std::size_t(j)] = weight;
    V* const out = &q_[at(j, n_, 0)];
    if (p.samples_are_points() && fixed_ == 0) {
      p.monomials.evaluate(u, weight, out);
    } else {
      if (p.samples_are_points())
        p.monomials.evaluate(u, V{} + 1, row_.data());
      else
        p.samples.evaluate(p.monomials, p.components, sample, origin, inverse, row_.data());
      reduce(row_.data());
      for (int i = 0; i < fixed_; ++i) fixed_q_[at(j, fixed_, i)] = weight * reduced_[std::size_t(i)];
      for (int i = 0; i < free_; ++i) out[i] = weight * reduced_[std::size_t(fixed_ + i)];
    }
    V largest{};
    for (int i = 0; i < free_; ++i) largest = at_least(largest, magnitude(out[i]));
    largest_[std::size_t(j)] = largest;
  }

  /// A row for the basis of the space, exact rows reflected away: the first `fixed_` numbers are what they see.
  void reduce(V const* full) {
    Problem const& p = problem_;
    if (p.basis.empty())
      std::copy(full, full + p.full(), reduced_.begin());
    else
      for (int i = 0; i < p.unknowns(); ++i) {
        V sum{};
        for (int k = 0; k < p.full(); ++k) sum += full[k] * p.basis[at(k, p.unknowns(), i)];
        reduced_[std::size_t(i)] = sum;
      }
    for (int c = 0; c < reflectors_; ++c) reflect(c);
  }
  void reflect(int c) {
    V const* const v = &reflector_[at(c, problem_.unknowns(), 0)];
    V along{};
    for (int i = c; i < problem_.unknowns(); ++i) along += v[i] * reduced_[std::size_t(i)];
    for (int i = c; i < problem_.unknowns(); ++i) reduced_[std::size_t(i)] = reduced_[std::size_t(i)] - along * v[i];
  }

  /// Householder's reflection of exact row c onto coefficient c.
  void add_reflector(V const* full, int c) {
    reflectors_ = c;
    reduce(full);
    int const unknowns = problem_.unknowns();
    V all{}, rest{};
    for (int i = 0; i < unknowns; ++i) {
      V const square = reduced_[std::size_t(i)] * reduced_[std::size_t(i)];
      all += square;
      if (i >= c) rest += square;
    }
    V const length = root(rest), first = reduced_[std::size_t(c)];
    V const onto = first > V{} ? V{} - length : length;
    V const zero{}, one = V{} + 1;
    independent_ = rest > 1e-16 * all ? independent_ : zero;
    V const square = rest - first * onto;  // half of |v|²
    V const scale = inverse_root(square > V{} ? square : one);
    V* const v = &reflector_[at(c, unknowns, 0)];
    for (int i = c; i < unknowns; ++i) v[i] = scale * reduced_[std::size_t(i)];
    v[c] = scale * (first - onto);
    for (int row = 0; row < c; ++row) upper_[at(row, fixed_, c)] = reduced_[std::size_t(row)];
    upper_[at(c, fixed_, c)] = onto;
    reflectors_ = c + 1;
  }

  // ---- normal equations ----

  /// QᵀQ, a few rows of Q at a time, so that they stay in the first cache.
  void form() {
    constexpr int rows = 8;
    for (int first = 0; first < m_; first += rows)
      for (int i = 0; i < n_; i += 2)
        for (int k = 0; k <= i; k += 2) {
          V const* const q = &q_[at(first, n_, 0)];
          add_products(std::min(rows, m_ - first), q + i, n_, 1, q + k, n_, 1, &matrix_[at(i, n_, k)], n_);
        }
  }

  /// Cholesky's factor, in place; pivots over their diagonal entries say how well the equations determine the result.
  void factor() {
    V const zero{}, one = V{} + 1;
    least_pivot_ = one;
    for (int k = 0; k < free_; ++k) {
      V const diagonal = matrix_[at(k, n_, k)];
      for (int i = k; i < free_; ++i) {
        V sum = matrix_[at(i, n_, k)];
        for (int j = 0; j < k; ++j) sum = sum - matrix_[at(i, n_, j)] * matrix_[at(k, n_, j)];
        matrix_[at(i, n_, k)] = i == k ? sum : sum * inverse_root_[std::size_t(k)];
        if (i == k) {
          V const ratio = diagonal > zero ? sum / (diagonal > zero ? diagonal : one) : zero;
          least_pivot_ = ratio < least_pivot_ ? ratio : least_pivot_;
          inverse_root_[std::size_t(k)] = inverse_root(ratio > pivot_tolerance ? sum : one);
        }
      }
    }
  }

  /// y += (QᵀQ)⁻¹ residual.
  void add_solution_of_residual() {
    for (int i = 0; i < free_; ++i)
      for (int t = 0; t < targets_; ++t) {
        V sum = residual_[at(i, wide_, t)];
        for (int j = 0; j < i; ++j) sum = sum - matrix_[at(i, n_, j)] * residual_[at(j, wide_, t)];
        residual_[at(i, wide_, t)] = sum * inverse_root_[std::size_t(i)];
      }
    for (int i = free_ - 1; i >= 0; --i)
      for (int t = 0; t < targets_; ++t) {
        V sum = residual_[at(i, wide_, t)];
        for (int j = i + 1; j < free_; ++j) sum = sum - matrix_[at(j, n_, i)] * residual_[at(j, wide_, t)];
        residual_[at(i, wide_, t)] = sum * inverse_root_[std::size_t(i)];
        y_[at(i, wide_, t)] += residual_[at(i, wide_, t)];
      }
  }

  /// z = Q y, and what is missing to the reproduction of the space.
  void reproduce() {
    std::fill(z_.begin(), z_.end(), V{});
    for (int j = 0; j < m_; j += 2)
      for (int t = 0; t < wide_; t += 2)
        add_products(n_, &q_[at(j, n_, 0)], 1, n_, &y_[std::size_t(t)], wide_, 1, &z_[at(j, wide_, t)], wide_);
    find_residual();
  }

  /// τ - Qᵀz.
  void find_residual() {
    std::fill(residual_.begin(), residual_.end(), V{});
    for (int i = 0; i < n_; i += 2)
      for (int t = 0; t < wide_; t += 2)
        add_products(m_, &q_[std::size_t(i)], n_, 1, &z_[std::size_t(t)], wide_, 1, &residual_[at(i, wide_, t)], wide_);
    for (std::size_t i = 0; i < residual_.size(); ++i) residual_[i] = tau_[i] - residual_[i];
  }

  // ---- the result ----

  /// Judge the weights, and write them where all targets' are.
  void write(Each<V> const& of, Stencils const& to, Path path) {
    V worst{}, sum_of_sizes{};
    for (int t = 0; t < targets_; ++t) {
      V missing{}, size{}, sum{};
      for (int i = 0; i < free_; ++i) {
        missing = at_least(magnitude(residual_[at(i, wide_, t)]), missing);
        size = at_least(size, magnitude(tau_[at(i, wide_, t)]));
      }
      for (int j = 0; j < m_; ++j) sum += magnitude(z_[at(j, wide_, t)]) * largest_[std::size_t(j)];
      V const tiny = V{} + std::numeric_limits<Real>::min();
      // a product with zero, so that no maximum drops what is no number
      worst = at_least(missing / at_least(at_least(size, sum), tiny), worst) + 0 * sum;
      sum_of_sizes = at_least(sum_of_sizes, sum / at_least(size, tiny));
    }
    weigh_exact_data();
    for (int j = 0; j < m_; ++j)
      for (int t = 0; t < targets_; ++t) z_[at(j, wide_, t)] = z_[at(j, wide_, t)] * root_weight_[std::size_t(j)];
    auto const each = [&](V const& value, auto&& f) {
      std::array<Real, std::size_t(width<V>)> numbers;
      store(numbers.data(), value);
      for (std::size_t l = 0; l < of.size(); ++l) f(of[l], numbers[l]);
    };
    for (int j = 0; j < m_; ++j)
      for (int t = 0; t < targets_; ++t)
        each(z_[at(j, wide_, t)], [&](std::size_t target, Real value) {
          if (j < problem_.neighbours(target)) to.weight[(problem_.start[target] + j) * targets_ + t] = value;
        });
    for (int c = 0; c < fixed_; ++c)
      for (int t = 0; t < targets_; ++t)
        each(fixed_tau_[at(c, wide_, t)], [&](std::size_t target, Real value) {
          to.exact_weight[(target * std::size_t(fixed_) + std::size_t(c)) * std::size_t(targets_) + std::size_t(t)] =
              value;
        });
    if (path == Path::normal_equations) each(least_pivot_, [&](std::size_t target, Real v) { to.pivot[target] = v; });
    each(worst, [&](std::size_t target, Real v) { to.residual[target] = v; });
    each(sum_of_sizes, [&](std::size_t target, Real v) { to.sum[target] = v; });
    each(independent_, [&](std::size_t target, Real v) { to.path[target] = v > 0 ? path : Path::dependent; });
  }

  /// R β = H (τ - Pᵀα) in the first columns, by back substitution in place.
  void weigh_exact_data() {
    V const zero{}, one = V{} + 1;
    for (int c = fixed_ - 1; c >= 0; --c)
      for (int t = 0; t < targets_; ++t) {
        V sum = fixed_tau_[at(c, wide_, t)];
        for (int j = 0; j < m_; ++j) sum = sum - fixed_q_[at(j, fixed_, c)] * z_[at(j, wide_, t)];
        for (int k = c + 1; k < fixed_; ++k) sum = sum - upper_[at(c, fixed_, k)] * fixed_tau_[at(k, wide_, t)];
        V const pivot = upper_[at(c, fixed_, c)];
        fixed_tau_[at(c, wide_, t)] = sum / (independent_ > zero ? pivot : one);
      }
  }

  Problem const& problem_;
  int targets_, wide_, fixed_, free_, n_, m_ = 0, reflectors_ = 0;
  std::vector<V> row_, reduced_, reflector_, upper_;
  std::vector<V> q_, fixed_q_, root_weight_, largest_, z_;
  std::vector<V> tau_, fixed_tau_, y_, residual_, matrix_, inverse_root_;
  V least_pivot_{}, independent_{};
};

}  // namespace amrpic::gmls
