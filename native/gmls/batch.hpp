// As many problems as the processor has lanes, all in step: one text for vectors and for single numbers.
#pragma once

#include <algorithm>
#include <limits>
#include <type_traits>
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

typedef Real OneLane __attribute__((may_alias));

// A pivot over its diagonal entry: above the first number the equations are trusted, below the second one the column
// depends on those before it, as it often does on lattices. Between them only orthogonal factors tell.
constexpr Real pivot_tolerance = 1e-5, pivot_of_rounding = 1e-13;

/// What a column that depends on others may lack of its right-hand side, relative, before no weights are looked for.
constexpr Real far_from_dependent = 1e-3;

constexpr int first_cache = 24 << 10;  ///< bytes, of which something is left for other things

/// Change of a weight by refinement, over the sum of all, that is not worth its time.
constexpr Real small_change = 2e-14;

/// Call f(first, number of columns as a constant) for columns in groups of `most`, and once for the rest: as many sums
/// as registers hold, so that none waits for another.
template <int most = 6, class F>
inline void in_columns(int columns, F&& f, int first = 0) {
  for (; columns - first >= most; first += most) f(first, std::integral_constant<int, most>());
  if constexpr (most > 1)
    if (first < columns) in_columns<most - 1>(columns, f, first);
}

/// c(a, b) = sum over k < count of x(k, a) y(k, b), for two a and some b side by side, or, if `more`, that is added;
/// steps are from k to k, and from the first a to the second.
template <int columns, class V>
inline void find_products(int count, V const* x, std::ptrdiff_t x_step, std::ptrdiff_t x_beside, V const* y,
                          std::ptrdiff_t y_step, V* c, std::ptrdiff_t c_beside, bool more = false) {
  V first[columns] = {}, second[columns] = {};
  if (more)
    for (int b = 0; b < columns; ++b) first[b] = c[b], second[b] = c[c_beside + b];
  for (int k = 0; k < count; ++k, x += x_step, y += y_step) {
    V const x0 = x[0], x1 = x[x_beside];
    for (int b = 0; b < columns; ++b) first[b] += x0 * y[b], second[b] += x1 * y[b];
  }
  for (int b = 0; b < columns; ++b) c[b] = first[b], c[c_beside + b] = second[b];
}

/// Weighted least squares with the targets first. With Q = √W P, of rows √w λ(p), the weights are α = √W z, where
/// z = Q y and QᵀQ y = τ; then Qᵀz = τ: polynomials of the space are reproduced.
///
/// Exact rows C are eliminated first: with Householder's H, H Cᵀ = [R; 0], the polynomials that C does not see are the
/// last columns of Q Hᵀ, and the weights β of the data of C follow from R β = (H (τ - Pᵀα)) in the first columns.
///
/// Q has even numbers of rows and columns, the last one zero where there is one too many.
template <class V>
class Batch {
 public:
  explicit Batch(Problem const& problem)
      : problem_(problem),
        targets_(problem.wanted.rows),
        fixed_(problem.exact.rows),
        free_(problem.unknowns() - fixed_),
        n_(even(free_)) {}

  /// The stencils of some targets, by normal equations.
  void solve(Each<V> const& of, Stencils const& to) {
    fill(of);
    form();
    factor();
    find_contradictions();
    if (all_contradict()) return judge(of, to, Path::normal_equations, contradiction_, V{});  // no weights
    y_ = tau_;
    substitute_forward(y_);
    substitute_backward(y_);
    reproduce(false);
    refine();
    write(of, to, Path::normal_equations);
  }

  /// Ask for the memory of some targets' neighbours and weights, so that it is near when they come.
  void prefetch(Each<V> const& of, Stencils const& to) const {
    constexpr std::int64_t line = 64;
    for (std::size_t target : of) {
      std::int64_t const first = problem_.start[target], last = problem_.start[target + 1];
      for (auto at = first; at < last; at += line / std::int64_t(sizeof(LocalIndex)))
        __builtin_prefetch(problem_.index + at);
      for (auto at = first * targets_; at < last * targets_; at += line / std::int64_t(sizeof(Real)))
        __builtin_prefetch(to.weight + at, 1);
    }
  }

  /// The same, of one target, by orthogonal factors of least norm: for problems that the equations do not determine.
  void solve_by_factors(Each<V> const& of, Stencils const& to) {
    Equations const e = equations(of);
    std::vector<Real> z(std::size_t(m_ * targets_));
    least_norm(int(e.root_weight.size()), free_, targets_, e.rows.data(), e.tau.data(), z.data());
    std::fill(z_.begin(), z_.end(), V{});
    for (int j = 0; j < int(e.root_weight.size()); ++j)
      for (int t = 0; t < targets_; ++t) z_[at(j, targets_, t)] = z[at(j, targets_, t)];
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
      out.tau.insert(out.tau.end(), &tau_[at(i, targets_, 0)], &tau_[at(i, targets_, 0)] + targets_);
    return out;
  }

 private:
  static int even(int n) { return n + n % 2; }
  static std::size_t at(int row, int columns, int column) {
    return std::size_t(row) * std::size_t(columns) + std::size_t(column);
  }

  static Real number(V const& of, std::size_t lane) { return reinterpret_cast<OneLane const*>(&of)[lane]; }

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

    row_.resize(std::size_t(std::max({p.wanted.rows, fixed_, 1}) * p.full()));
    reduced_.resize(std::size_t(unknowns));
    if (fixed_ > 0) {
      p.exact.evaluate(p.monomials, p.components, of, {}, inverse, row_.data());
      for (int c = 0; c < fixed_; ++c) add_reflector(row_.data() + c * p.full(), c);
    }
    evaluate_wanted(of, inverse);
    for (int t = 0; t < targets_; ++t) {
      V const* const full = row_.data() + t * p.full();
      for (int i = 0; i < p.full(); ++i) size_[std::size_t(t)] = at_least(magnitude(full[i]), size_[std::size_t(t)]);
      reduce(full);
      for (int i = 0; i < fixed_; ++i) fixed_tau_[at(i, targets_, t)] = reduced_[std::size_t(i)];
      for (int i = 0; i < free_; ++i) tau_[at(i, targets_, t)] = reduced_[std::size_t(fixed_ + i)];
    }
    gather(of, longest);
    for (int j = 0; j < longest; ++j) fill_row(j, origin, inverse);
  }

  /// Places of samples in all rows, or their numbers; lanes that have fewer neighbours repeat the last one. Apart from
  /// what reads them as vectors, which would wait for numbers that were only just stored.
  void gather(Each<V> const& of, int rows) {
    Problem const& p = problem_;
    auto const all = std::size_t(rows);
    bool const numbers = !p.samples_are_points();
    place_.resize(all * std::size_t(p.dimension));
    if (numbers) sample_.resize(all);
    in_columns<3>(p.dimension, [&](int, auto dimension) {
      for (std::size_t l = 0; l < of.size(); ++l) {
        auto const count = std::size_t(p.neighbours(of[l]));
        LocalIndex const* const index = p.index + p.start[of[l]];
        reinterpret_cast<OneLane*>(&count_)[l] = Real(count);
        auto* place = reinterpret_cast<OneLane*>(place_.data()) + l;
        for (std::size_t j = 0; j < all; ++j) {
          auto const sample = std::size_t(index[std::min(j, count - 1)]);
          if (numbers) sample_[j][l] = sample;
          for (int d = 0; d < dimension; ++d, place += width<V>)
            *place = p.sites[sample * std::size_t(dimension) + std::size_t(d)];
        }
      }
    });
  }

  /// Rows of what is wanted, where all targets want the same from a table: of u = x / s the monomial u^e is x^e / s^e.
  void evaluate_wanted(Each<V> const& of, std::array<V, 3> const& inverse) {
    Problem const& p = problem_;
    if (p.wanted.count > 1) return p.wanted.evaluate(p.monomials, p.components, of, {}, inverse, row_.data());
    V const one = V{} + 1;
    if (table_.empty()) {
      table_.resize(std::size_t(targets_ * p.full()));
      p.wanted.evaluate(p.monomials, p.components, of, {}, {one, one, one}, table_.data());
    }
    powers_.resize(std::size_t(p.monomials.count()));
    p.monomials.evaluate(inverse, one, powers_.data());
    std::size_t at = 0;
    for (int row = 0; row < targets_ * p.components; ++row)
      for (V const& power : powers_) row_[at] = table_[at] * power, ++at;
  }

  void resize(int unknowns) {
    auto const sized = [](std::vector<V>& values, int count) { values.resize(std::size_t(count)); };
    auto const zeros = [](std::vector<V>& values, int count) { values.assign(std::size_t(count), V{}); };
    sized(q_, m_ * n_), sized(z_, m_ * targets_), sized(root_weight_, m_), sized(largest_, m_);
    for (int j = 0; j < m_; ++j) q_[at(j, n_, n_ - 1)] = V{};
    if (m_ > 0) {
      std::fill(&q_[at(m_ - 1, n_, 0)], &q_[at(m_ - 1, n_, 0)] + n_, V{});
      root_weight_.back() = largest_.back() = V{};
    }
    sized(residual_, n_ * targets_), sized(matrix_, n_ * n_), sized(inverse_root_, n_);
    sized(sum_, targets_), zeros(size_, targets_), zeros(tau_, n_ * targets_);
    zeros(fixed_q_, m_ * fixed_), zeros(fixed_tau_, fixed_ * targets_);
    zeros(reflector_, fixed_ * unknowns), zeros(upper_, fixed_ * fixed_);
    independent_ = V{} + 1;
  }

  /// Row j of Q, in all lanes that have so many neighbours.
  void fill_row(int j, std::array<V, 3> const& origin, std::array<V, 3> const& inverse) {
    Problem const& p = problem_;
    std::array<V, 3> u{};
    V square{};
    V const* const place = &place_[at(j, p.dimension, 0)];
    for (std::size_t d = 0; d < std::size_t(p.dimension); ++d) {
      u[d] = (place[d] - origin[d]) * inverse[d];
      square += u[d] * u[d];
    }
    V const zero{}, root_inside = root_of_weight(p.weight, square);
    V const weight = count_ > zero + Real(j) ? root_inside : zero;
    root_weight_[std::size_t(j)] = weight;
    V* const out = &q_[at(j, n_, 0)];
    if (p.samples_are_points() && fixed_ == 0 && p.basis.empty()) {
      p.monomials.evaluate(u, weight, out);
      largest_[std::size_t(j)] = weight;  // of the constant; |u| < 1
    } else {
      if (p.samples_are_points())
        p.monomials.evaluate(u, V{} + 1, row_.data());
      else
        p.samples.evaluate(p.monomials, p.components, sample_[std::size_t(j)], origin, inverse, row_.data());
      reduce(row_.data());
      for (int i = 0; i < fixed_; ++i) fixed_q_[at(j, fixed_, i)] = weight * reduced_[std::size_t(i)];
      for (int i = 0; i < free_; ++i) out[i] = weight * reduced_[std::size_t(fixed_ + i)];
      V largest{};
      for (int i = 0; i < free_; ++i) largest = at_least(largest, magnitude(out[i]));
      largest_[std::size_t(j)] = largest;
    }
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
    int const rows = std::max(8, first_cache / (n_ * int(sizeof(V))));
    for (int first = 0; first < m_; first += rows)
      for (int i = 0; i < n_; i += 2)
        in_columns(i + 2, [&](int k, auto columns) {
          V const* const q = &q_[at(first, n_, 0)];
          V* const to = &matrix_[at(i, n_, k)];
          find_products<columns>(std::min(rows, m_ - first), q + i, n_, 1, q + k, n_, to, n_, first > 0);
        });
  }

  /// Cholesky's factor, in place. A column that depends on those before it is left out: its y is zero, and z = Q y, in
  /// the range of Q, still is the solution of least norm if there is one, which its residual shows.
  void factor() {
    V const zero{}, one = V{} + 1;
    least_pivot_ = one, unclear_ = zero;
    V largest = zero;
    for (int k = 0; k < free_; ++k) largest = at_least(largest, matrix_[at(k, n_, k)]);
    V const rounding = largest * (zero_column * zero_column);
    for (int k = 0; k < free_; ++k) {
      V const diagonal = matrix_[at(k, n_, k)];
      auto const eliminate = [&](int i, auto rows) {  // what earlier columns make of some entries of column k
        V sum[rows];
        for (int b = 0; b < rows; ++b) sum[b] = matrix_[at(i + b, n_, k)];
        for (int j = 0; j < k; ++j)
          for (int b = 0; b < rows; ++b) sum[b] = sum[b] - matrix_[at(i + b, n_, j)] * matrix_[at(k, n_, j)];
        for (int b = 0; b < rows; ++b) matrix_[at(i + b, n_, k)] = sum[b];
      };
      in_columns(free_, eliminate, k);
      V const left = matrix_[at(k, n_, k)];
      V const ratio = diagonal > rounding ? left / (diagonal > rounding ? diagonal : one) : zero;
      least_pivot_ = ratio < least_pivot_ ? at_least(ratio, zero) : least_pivot_;
      V const inverse = inverse_root(ratio > pivot_tolerance ? left : one);
      inverse_root_[std::size_t(k)] = ratio > pivot_tolerance ? inverse : zero;
      V const unclear = ratio > pivot_of_rounding ? one : zero;
      unclear_ = ratio > pivot_tolerance ? unclear_ : at_least(unclear_, unclear);
      for (int i = k; i < free_; ++i) matrix_[at(i, n_, k)] = matrix_[at(i, n_, k)] * inverse_root_[std::size_t(k)];
    }
  }

  /// Which lanes have no solution, as most lattices have that are too small: the right-hand side of a column that was
  /// left out is not what those before it make of theirs.
  void find_contradictions() {
    V const zero{};
    contradiction_ = zero;
    bool dependent = false;
    for (int l = 0; l < width<V>; ++l) dependent = dependent || number(least_pivot_, std::size_t(l)) <= pivot_tolerance;
    if (!dependent) return;
    std::vector<V> rest = tau_;
    for (int t = 0; t < targets_; ++t)
      for (int i = 0; i < free_; ++i) {
        V sum = rest[at(i, targets_, t)];
        for (int j = 0; j < i; ++j) sum = sum - matrix_[at(i, n_, j)] * rest[at(j, targets_, t)];
        V const lacking = magnitude(sum) / at_least(size_[std::size_t(t)], zero + std::numeric_limits<Real>::min());
        contradiction_ = inverse_root_[std::size_t(i)] > zero ? contradiction_ : at_least(lacking, contradiction_);
        rest[at(i, targets_, t)] = sum * inverse_root_[std::size_t(i)];
      }
    V const clear = unclear_ > zero ? zero : contradiction_;
    contradiction_ = clear > far_from_dependent ? clear : zero;
  }
  bool all_contradict() const {
    for (int l = 0; l < width<V>; ++l)
      if (number(contradiction_, std::size_t(l)) == 0) return false;
    return true;
  }

  /// x = L⁻¹ x, of Cholesky's factor L.
  void substitute_forward(std::vector<V>& x) const {
    for (int i = 0; i < free_; ++i) substitute(x, i, 0, i, &matrix_[at(i, n_, 0)], 1);
  }
  /// x = L⁻ᵀ x.
  void substitute_backward(std::vector<V>& x) const {
    for (int i = free_ - 1; i >= 0; --i) substitute(x, i, i + 1, free_, &matrix_[at(i, n_, i)] + n_, n_);
  }
  /// Row i, by the rows from `first` to `last`; the step is between the entries of L for them.
  void substitute(std::vector<V>& x, int i, int first, int last, V const* entries, std::ptrdiff_t step) const {
    in_columns(targets_, [&](int t, auto columns) {
      V* const r = &x[std::size_t(t)];
      V const* entry = entries;
      V sum[columns];
      for (int b = 0; b < columns; ++b) sum[b] = r[i * targets_ + b];
      for (int j = first; j < last; ++j, entry += step)
        for (int b = 0; b < columns; ++b) sum[b] = sum[b] - *entry * r[j * targets_ + b];
      for (int b = 0; b < columns; ++b) r[i * targets_ + b] = sum[b] * inverse_root_[std::size_t(i)];
    });
  }

  /// Correct z by the solution for the residual r, in those lanes where it matters: the change δz of z has the length
  /// of L⁻¹ r, as QᵀQ = L Lᵀ, and that of a weight is at most so long. Not y: it is so much larger than z, where pivots
  /// are small, that its rounding would come back.
  void refine() {
    y_ = residual_;
    substitute_forward(y_);
    V const zero{}, one = V{} + 1;
    V largest = zero, matters = zero;
    for (V const& l : largest_) largest = at_least(l, largest);
    for (int t = 0; t < targets_; ++t) {
      V change = zero;
      for (int i = 0; i < free_; ++i) change += y_[at(i, targets_, t)] * y_[at(i, targets_, t)];
      V const bound = small_change * sum_[std::size_t(t)];
      matters = change * (largest * largest) > bound * bound ? one : matters;
    }
    bool any = false;
    for (int l = 0; l < width<V>; ++l) any = any || number(matters, std::size_t(l)) > 0;
    if (!any) return;
    substitute_backward(y_);
    for (V& y : y_) y = matters > zero ? y : zero;
    reproduce(true);
  }

  /// z = Q y, or, if `more`, that is added; and what is missing to the reproduction of the space.
  void reproduce(bool more) {
    for (int j = 0; j < m_; j += 2)
      in_columns(targets_, [&](int t, auto columns) {
        V* const to = &z_[at(j, targets_, t)];
        find_products<columns>(n_, &q_[at(j, n_, 0)], 1, n_, &y_[std::size_t(t)], targets_, to, targets_, more);
      });
    find_residual();
  }

  /// τ - Qᵀz, and the sums of |z λ|.
  void find_residual() {
    for (int i = 0; i < n_; i += 2)
      in_columns(targets_, [&](int t, auto columns) {
        V* const to = &residual_[at(i, targets_, t)];
        find_products<columns>(m_, &q_[std::size_t(i)], n_, 1, &z_[std::size_t(t)], targets_, to, targets_);
      });
    for (std::size_t i = 0; i < residual_.size(); ++i) residual_[i] = tau_[i] - residual_[i];
    in_columns(targets_, [&](int t, auto columns) {
      V sum[columns] = {};
      for (int j = 0; j < m_; ++j)
        for (int b = 0; b < columns; ++b) sum[b] += magnitude(z_[at(j, targets_, t + b)]) * largest_[std::size_t(j)];
      for (int b = 0; b < columns; ++b) sum_[std::size_t(t + b)] = sum[b];
    });
  }

  // ---- the result ----

  /// Write the weights where all targets' are, and judge them.
  void write(Each<V> const& of, Stencils const& to, Path path) {
    V worst{}, sum_of_sizes{};
    V const tiny = V{} + std::numeric_limits<Real>::min();
    for (int t = 0; t < targets_; ++t) {
      V missing{};
      for (int i = 0; i < free_; ++i) missing = at_least(magnitude(residual_[at(i, targets_, t)]), missing);
      V const size = at_least(size_[std::size_t(t)], tiny), sum = sum_[std::size_t(t)];
      // of all monomials: the space may see none of it; a product with zero, so that no maximum drops what is no number
      worst = at_least(missing / at_least(size, sum), worst) + 0 * sum;
      sum_of_sizes = at_least(sum / size, sum_of_sizes);
    }
    if (path == Path::normal_equations) {
      worst = contradiction_ > V{} ? contradiction_ : worst;
      sum_of_sizes = contradiction_ > V{} ? V{} : sum_of_sizes;
    }
    weigh_exact_data();
    for (int j = 0; j < m_; ++j)
      for (int t = 0; t < targets_; ++t) z_[at(j, targets_, t)] = z_[at(j, targets_, t)] * root_weight_[std::size_t(j)];
    for (std::size_t l = 0; l < of.size(); ++l) {
      Real* const out = to.weight + problem_.start[of[l]] * targets_;
      auto const* const from = reinterpret_cast<OneLane const*>(z_.data()) + l;
      auto const count = (problem_.start[of[l] + 1] - problem_.start[of[l]]) * targets_;
      for (std::int64_t k = 0; k < count; ++k) out[k] = from[k * width<V>];
    }
    for (std::size_t l = 0; l < of.size(); ++l)
      for (int c = 0; c < fixed_; ++c)
        for (int t = 0; t < targets_; ++t)
          to.exact_weight[(of[l] * std::size_t(fixed_) + std::size_t(c)) * std::size_t(targets_) + std::size_t(t)] =
              number(fixed_tau_[at(c, targets_, t)], l);
    judge(of, to, path, worst, sum_of_sizes);
  }

  void judge(Each<V> const& of, Stencils const& to, Path path, V const& residual, V const& sum) const {
    bool const by_equations = path == Path::normal_equations;
    for (std::size_t l = 0; l < of.size(); ++l) {
      if (by_equations) to.pivot[of[l]] = number(least_pivot_, l);
      to.residual[of[l]] = number(residual, l);
      to.sum[of[l]] = number(sum, l);
      to.path[of[l]] = number(independent_, l) == 0                                 ? Path::dependent
                       : by_equations && number(unclear_, l) > 0                    ? Path::undetermined
                       : by_equations && number(least_pivot_, l) <= pivot_tolerance ? Path::less_rank
                                                                                    : path;
    }
  }

  /// R β = H (τ - Pᵀα) in the first columns, by back substitution in place.
  void weigh_exact_data() {
    V const zero{}, one = V{} + 1;
    for (int c = fixed_ - 1; c >= 0; --c)
      for (int t = 0; t < targets_; ++t) {
        V sum = fixed_tau_[at(c, targets_, t)];
        for (int j = 0; j < m_; ++j) sum = sum - fixed_q_[at(j, fixed_, c)] * z_[at(j, targets_, t)];
        for (int k = c + 1; k < fixed_; ++k) sum = sum - upper_[at(c, fixed_, k)] * fixed_tau_[at(k, targets_, t)];
        V const pivot = upper_[at(c, fixed_, c)];
        fixed_tau_[at(c, targets_, t)] = sum / (independent_ > zero ? pivot : one);
      }
  }

  Problem const& problem_;
  int targets_, fixed_, free_, n_, m_ = 0, reflectors_ = 0;
  std::vector<V> row_, table_, powers_, reduced_, reflector_, upper_;
  std::vector<Each<V>> sample_;
  std::vector<V> place_, q_, fixed_q_, root_weight_, largest_, z_;
  std::vector<V> size_, sum_, tau_, fixed_tau_, y_, residual_, matrix_, inverse_root_;
  V count_{}, least_pivot_{}, unclear_{}, independent_{}, contradiction_{};
};

}  // namespace amrpic::gmls
