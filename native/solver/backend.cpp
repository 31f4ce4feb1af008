#include "solver/backend.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <utility>

#include "cycle/capacity.hpp"
#include "mesh/fits_behind.hpp"

namespace amrpic {

namespace {

/// The problem, if its cells find place. Collective.
Problem const& checked(Problem const& problem) {
  cycle::check_places(*problem.hierarchy, 2 * std::max(problem.options.pre_sweeps, problem.options.post_sweeps));
  return problem;
}

/// Sum of the products of two rows in double precision, several sums at a time, which the processor adds at once.
Real product(float const* a, float const* b, int n) {
  constexpr int lanes = 8;
  Real sums[lanes] = {};
  int i = 0;
  for (; i + lanes <= n; i += lanes)
    for (int lane = 0; lane < lanes; ++lane) sums[lane] += Real(a[i + lane]) * b[i + lane];
  for (; i < n; ++i) sums[0] += Real(a[i]) * b[i];
  return std::accumulate(sums, sums + lanes, Real(0));
}

/// One over the roots of Chebyshev's polynomial of some degree on [least, largest], in an order in which no error grows
/// on the way.
void add_roots(int degree, Real least, Real largest, std::vector<Real>& to) {
  for (int n = 0; n < degree; ++n) {
    int const root = n == degree - 1 ? degree / 2 : n % 2 == 0 ? degree - 1 - n / 2 : n / 2;
    Real const cosine = std::cos((2 * root + 1) * M_PI / (2 * degree));
    to.push_back(2 / (least + largest + (largest - least) * cosine));
  }
}

/// Factors of the corrections, in turn. Of the fourth-order residual the damped cycle of the seven-point Laplacian
/// finds too much of what oscillates: in its terms the operator has eigenvalues from 1 to 11/9, and what the cycle
/// itself leaves of an error, and walls, widen that by a few hundredths. The polynomials of degree five and three suit
/// that, and a factor of one between them what is smooth, and most at first.
std::vector<Real> step_lengths(SolverOptions const& options) {
  if (options.order == 2) return {1};
  constexpr Real least = 0.97, largest = 1.26;
  std::vector<Real> out;
  add_roots(5, least, largest, out);
  out.push_back(1);
  add_roots(3, least, largest, out);
  return out;
}

/// Factors of the Jacobi steps that coarse cells behind faces with fits in narrow gaps take after each cycle that is
/// accelerated, with the composite residual over the diagonal of their level's own equations: at walls it is larger,
/// and with that of cells elsewhere such steps would overshoot there.
///
/// A cycle sees the flux between two cells of the coarser level as the difference of their values. With a fit it is
/// less for errors that change sign from cell to cell, since the fit takes values from all around: down to a share x of
/// 0.3 on a checkerboard of single blocks of two cells, so that cycles leave 0.7 of such errors, and with the steps (1
/// - x)(1 - x)(1 - 1.8 x), at most 0.23. Larger factors leave less of these, but oscillate where fine cells respond.
constexpr std::array<Real, 2> steps_behind_gaps{1.0, 1.8};

}  // namespace

Backend::Backend(Problem const& problem)
    : problem_(checked(problem)),
      composite_(problem.hierarchy, shift_of(problem.options), problem.options.stretch, problem.options.order,
                 problem.metal.get()),
      cycle_(problem.hierarchy->comm(), *problem.hierarchy, shift_of(problem.options),
             {problem.options.pre_sweeps, problem.options.post_sweeps, problem.options.relaxation},
             problem.options.order, composite_.mesh().plan().gap_fits, problem.options.most_direct_readers,
             problem.metal.get()),
      scale_(std::size_t(levels())),
      residual_(blocks(&cycle::SweptLevel::right_hand_side)),
      correction_(blocks(&cycle::SweptLevel::correction)),
      steps_(step_lengths(problem.options)) {
  if (problem.options.order == 4) damping_.emplace(composite_.mesh(), residual_, cycle_);
}

/// Where the boxes' cells lie in a vector of the cycle.
Blocks<float> Backend::blocks(cycle::Vector& (cycle::SweptLevel::*vector)()) {
  Blocks<float> out;
  for (int l = 0; l < levels(); ++l) {
    auto& swept = cycle_.level(std::size_t(l));
    auto& of_level = out.emplace_back();
    Level const& level = problem_.hierarchy->level(l);
    for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
      auto const cells = swept.layout().box(b);
      of_level.push_back({(swept.*vector)().data() + cells.origin, cells.pitch_y, cells.pitch_z});
    }
  }
  return out;
}

Real Backend::largest_right_hand_side() {
  largest_source_ = composite_.right_hand_side_norm(*source_, Norm::max);
  Real const base = cycle_.level(0).scale();  // so that corrections and residuals are of the order of one in any units
  Real const source = std::isnormal(largest_source_) ? largest_source_ : 1;
  unit_ = base * source;
  for (int l = 0; l < levels(); ++l) scale_[std::size_t(l)] = cycle_.level(std::size_t(l)).scale() / base / source;
  return largest_source_;
}

Real Backend::right_hand_side_norm() {
  return problem_.options.norm == Norm::max ? largest_source_
                                            : composite_.right_hand_side_norm(*source_, problem_.options.norm);
}

void Backend::start(Field& phi, bool is_zero) {
  phi_ = &phi;
  phi_is_zero_ = is_zero;
  accelerated_ = false;
  cycles_ = 0;
  corrections_.clear();
  if (is_zero && composite_.has_residual_of_zero()) return;
  if (problem_.metal)  // means of covered cells take its potentials in
    composite_.fill_metal(problem_.potentials, phi);
  else
    composite_.average_down(phi);
}

void Backend::set_mean(Field& phi, Real mean) const {
  Hierarchy const& hierarchy = *problem_.hierarchy;
  Real sum = 0;  // over the base, whose covered cells hold means
  for (Real v : phi.level(0)) sum += v;
  Real const excess = hierarchy.comm().sum(sum) / Real(hierarchy.level(0).cells()) - mean;
  for (int l = 0; l < levels(); ++l)
    for (Real& v : phi.level(l)) v -= excess;
}

Real Backend::residual() {
  stopwatch_.time("residual", [&] { latest_residual_ = find_residual(); });
  return latest_residual_;
}

Real Backend::find_residual() {
  Norm const norm = problem_.options.norm;
  return phi_is_zero_ && composite_.has_residual_of_zero()
             ? composite_.residual_of_zero(*source_, norm, scale_, residual_)
             : composite_.residual(*source_, *phi_, norm, scale_, residual_);
}

void Backend::improve() {
  MinimalResidual::Vectors before;
  for (int l = 0; l < levels() && accelerated_; ++l) before.push_back(cycle_.level(std::size_t(l)).right_hand_side());
  bool const damped = damping_ && !accelerated_;
  stopwatch_.time("cycle", [&] { damped ? damping_->run() : run_cycle(); });
  Real const step = unit_ * (accelerated_ ? 1 : steps_[cycles_++ % steps_.size()]);
  stopwatch_.time("correction",
                  [&] { latest_correction_ = damped ? composite_.add(residual_, step, *phi_) : add_correction(step); });
  phi_is_zero_ = false;
  if (!accelerated_) return;
  relax_behind_gaps();
  combine_corrections(before);
}

/// Find the cells behind gaps, when they are first needed.
void Backend::accelerate() {
  accelerated_ = true;
  if (std::exchange(knows_gaps_, true)) return;
  Hierarchy const& hierarchy = *problem_.hierarchy;
  bool has_any = false;
  behind_gaps_.resize(std::size_t(levels()));
  for (int l = 0; hierarchy.has_finer(l); ++l)
    for (Index3 const& cell : cells_behind_gaps(hierarchy.level(l), hierarchy.level(l + 1))) {
      auto const of_cell = cycle_.level(std::size_t(l)).place_and_diagonal(cell);
      if (of_cell.diagonal == 0) continue;  // in metal
      behind_gaps_[std::size_t(l)].push_back(of_cell);
      has_any = true;
    }
  if (!hierarchy.comm().any(has_any)) behind_gaps_.clear();
}

/// Jacobi steps that become part of the latest correction, see `steps_behind_gaps`.
void Backend::relax_behind_gaps() {
  if (behind_gaps_.empty()) return;
  MinimalResidual::Vectors total;
  for (int l = 0; l < levels(); ++l) total.push_back(cycle_.level(std::size_t(l)).correction());
  for (Real factor : steps_behind_gaps) {
    residual();
    for (std::size_t l = 0; l < total.size(); ++l) {
      auto& swept = cycle_.level(l);
      auto& step = swept.correction();
      std::fill(step.begin(), step.end(), 0.0f);
      for (auto const& [place, diagonal] : behind_gaps_[l]) {
        step[place] = -float(factor) / diagonal * swept.right_hand_side()[place];
        total[l][place] += step[place];
      }
    }
    add_correction(unit_);
  }
  for (std::size_t l = 0; l < total.size(); ++l)
    std::copy(total[l].begin(), total[l].end(), cycle_.level(l).correction().begin());
}

/// Change what the latest correction added to phi so that the residual becomes least.
void Backend::combine_corrections(MinimalResidual::Vectors const& before) {
  residual();
  stopwatch_.time("acceleration", [&] {
    MinimalResidual::Vectors correction, after;
    for (int l = 0; l < levels(); ++l) {
      correction.push_back(cycle_.level(std::size_t(l)).correction());
      after.push_back(cycle_.level(std::size_t(l)).right_hand_side());
    }
    corrections_.improve(
        correction, before, after, [this](auto const& a, auto const& b) { return dot(a, b); },
        problem_.hierarchy->comm());
    for (int l = 0; l < levels(); ++l) {
      auto const& combined = correction[std::size_t(l)];
      std::copy(combined.begin(), combined.end(), cycle_.level(std::size_t(l)).correction().begin());
    }
    add_correction(unit_);
  });
}

/// The product of two residuals over own cells, covered ones being zero. Each level's scale is divided out, up to a
/// factor common to all levels.
Real Backend::dot(MinimalResidual::Vectors const& a, MinimalResidual::Vectors const& b) {
  Real sum = 0;
  for (int l = 0; l < levels(); ++l) {
    auto const& swept = cycle_.level(std::size_t(l));
    Level const& level = problem_.hierarchy->level(l);
    Real of_level = 0;
    for (int n = level.first_local_box(); n < level.last_local_box(); ++n) {
      auto const cells = swept.layout().box(n);
      Box const& box = level.box(n);
      for (int k = 0; k < box.extent(2); ++k)
        for (int j = 0; j < box.extent(1); ++j) {
          std::size_t const row = std::size_t(cells.place(0, j, k));
          of_level += product(&a[std::size_t(l)][row], &b[std::size_t(l)][row], box.extent(0));
        }
    }
    Real const unscaled = scale_[0] / scale_[std::size_t(l)];
    sum += unscaled * unscaled * of_level;
  }
  return sum;
}

Real Backend::largest_correction() { return problem_.hierarchy->comm().largest(latest_correction_); }

/// Largest magnitude over all levels of vectors of the cycle, each over the scale of its level.
Real Backend::largest(Blocks<float> const& blocks, std::vector<Real> const& scale) {
  Real out = 0;
  for (int l = 0; l < levels(); ++l) {
    Largest<float> of_level;
    Level const& level = problem_.hierarchy->level(l);
    for (int b = level.first_local_box(); b < level.last_local_box(); ++b) {
      Block<float> const& block = blocks[std::size_t(l)][std::size_t(b - level.first_local_box())];
      Box const& box = level.box(b);
      for (int k = 0; k < box.extent(2); ++k)
        for (int j = 0; j < box.extent(1); ++j)
          of_level.add(block.origin + j * block.pitch_y + k * block.pitch_z, box.extent(0));
    }
    out = std::max(out, of_level.value() / scale[std::size_t(l)]);
  }
  return problem_.hierarchy->comm().largest(out);
}

/// One cycle with the truncation error; 0 while the residual is too large beside it.
Real Backend::discretisation_error() {
  Index3 const below = cycle_.ratio_below_base();
  if (problem_.options.order == 2 && levels() == 1 && below == Index3{1, 1, 1})
    return 0;  // nothing is coarser than the base, nothing finer
  Real const residual = problem_.options.norm == Norm::max ? latest_residual_ : largest(residual_, scale_);
  kept_.resize(std::size_t(levels()));  // dearer to find again than to copy
  for (int l = 0; l < levels(); ++l) {
    auto const& values = cycle_.level(std::size_t(l)).right_hand_side();
    kept_[std::size_t(l)].assign(values.begin(), values.end());
  }
  Real error = 0;
  if (residual < 0.1 * composite_.truncation(*source_, *phi_, below, scale_, residual_)) {
    run_cycle();
    error = largest(correction_, std::vector<Real>(std::size_t(levels()), 1 / unit_));
  }
  for (int l = 0; l < levels(); ++l) {
    auto const& values = kept_[std::size_t(l)];
    std::copy(values.begin(), values.end(), cycle_.level(std::size_t(l)).right_hand_side().begin());
  }
  return error;
}

std::size_t Backend::bytes() const {
  std::size_t sum = composite_.bytes() + cycle_.bytes() + (damping_ ? damping_->bytes() : 0);
  for (auto const& level : kept_) sum += level.capacity() * sizeof(float);
  return sum;
}

LevelOperators const& Backend::operators_with_gradient(int level) {
  if (!shown_) shown_ = assemble_to_show(problem_);
  return operators_of(*shown_, level);
}

}  // namespace amrpic
