#include "solver/crs_backend.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "base/for_rows.hpp"
#include "operators/multigrid_levels.hpp"
#include "solver/behind_gaps.hpp"

namespace amrpic {

CrsBackend::CrsBackend(Problem const& problem, Reusable& reusable)
    : problem_(problem),
      hierarchy_(problem.hierarchy),
      options_(problem.options),
      multigrid_levels_(coarsen_below(refinement_levels(*hierarchy_, shift_of(options_)), hierarchy_->domain(),
                                      {hierarchy_->max_grid_size()}, options_.coarse_levels)),
      operators_(assembled(reusable)),
      transfer_(hierarchy_),
      multigrid_(hierarchy_->comm(), multigrid_levels_, operators_, bottom(reusable), hierarchy_->max_grid_size(),
                 options_),
      krylov_(make_krylov(options_.krylov, equations())) {
  for (int l = 0; l < hierarchy_->level_count(); ++l) right_hand_side_.emplace_back(std::size_t(operators(l).rows()));
  phi_ = zero();
}

/// The operators; those that can be are taken over.
MultigridOperators CrsBackend::assembled(Reusable& reusable) {
  Assembled former;
  if (reusable.operators) former = std::move(*reusable.operators);
  reusable.operators = std::make_shared<Assembled>(
      assemble(hierarchy_->comm(), multigrid_levels_, options_.prolongation, std::move(former)));
  levels_assembled_ = reusable.operators->made;
  return reusable.operators->operators;
}

/// The bottom that was taken over if it serves, else a new one.
std::shared_ptr<Bottom> CrsBackend::bottom(Reusable& reusable) {
  if (!reusable.bottom || !reusable.bottom->serves(*operators_.front())) {
    reusable.bottom.reset();  // the old one goes before the new one comes
    reusable.bottom = std::make_shared<Bottom>(hierarchy_->comm(), *operators_.front(),
                                               is_singular(hierarchy_->domain(), options_), options_);
    ++bottom_setups_;
  }
  return reusable.bottom;
}

/// Zeros on all levels, with room for the halo.
CompositeVector CrsBackend::zero() const {
  CompositeVector out;
  for (int l = 0; l < hierarchy_->level_count(); ++l)
    out.emplace_back(std::size_t(operators(l).rows()) + std::size_t(operators(l).halo.size()));
  return out;
}

/// A norm over uncovered cells of the whole hierarchy of value(level, row); nan if one is not finite.
template <class Value>
Real CrsBackend::norm(Norm norm, Value&& value) const {
  Magnitude magnitude(norm);
  std::vector<Real> values;
  for (int l = 0; l < hierarchy_->level_count(); ++l) {
    values.clear();
    for_each_uncovered(l, [&](LocalIndex row) { values.push_back(value(l, row)); });
    Real const volume = problem_.given->level(l).cell_volume();  // as it is, for the absolute tolerance
    magnitude.add(values.data(), std::ptrdiff_t(values.size()), volume);
  }
  return magnitude.over(hierarchy_->comm());
}

Integral CrsBackend::integrate_right_hand_side() {
  std::array<Real, 2> sums{};
  for (int l = 0; l < hierarchy_->level_count(); ++l) {
    auto const& rho = rho_->level(l);
    std::vector<Real> sizes(rho.size());
    for_rows(operators(l).rows(), [&](LocalIndex row) {
      sizes[row] = Background::inverse_permittivity * std::abs(rho[row]) + std::abs(background_.mean);
    });
    Walls const& walls = problem_.walls[l];
    std::vector<Real> of_walls(rho.size());
    subtract_from_laplacian(walls, operators(l).walls,
                            multigrid_levels_.equation(multigrid_levels_.base + std::size_t(l)), of_walls);
    Real net = 0, size = 0;
    for_each_uncovered(l, [&](LocalIndex row) {
      net += right_hand_side_[l][row];
      size += sizes[row] + std::abs(of_walls[row]);
    });
    sums[0] += hierarchy_->level(l).cell_volume() * net;
    sums[1] += hierarchy_->level(l).cell_volume() * size;
  }
  hierarchy_->comm().sum_each(sums);
  return {sums[0], sums[1]};
}

void CrsBackend::set_right_hand_side(Field const& rho) {
  rho_ = &rho;
  take_away({});
}

void CrsBackend::take_away(Background const& background) {
  background_ = background;
  for (int l = 0; l < hierarchy_->level_count(); ++l) {
    auto& f = right_hand_side_[l];
    auto const& density = rho_->level(l);
    for_rows(operators(l).rows(), [&](LocalIndex row) { f[row] = background.right_hand_side(density[row]); });
    subtract_from_laplacian(problem_.walls[l], operators(l).walls,
                            multigrid_levels_.equation(multigrid_levels_.base + std::size_t(l)), f);
  }
}

/// From here on the vectors are of the order of one, whose squares a Krylov method may sum up.
Real CrsBackend::largest_right_hand_side() {
  Real const largest = norm(Norm::max, [&](int l, LocalIndex row) { return right_hand_side_[l][row]; });
  unit_ = std::isnormal(largest) ? std::ldexp(1.0, std::ilogb(largest)) : 1;
  for (auto& level : right_hand_side_)
    for (Real& f : level) f /= unit_;
  return largest;
}

Real CrsBackend::right_hand_side_norm() {
  return unit_ * norm(options_.norm, [&](int l, LocalIndex row) { return right_hand_side_[l][row]; });
}

Real CrsBackend::largest_phi_term() {
  return unit_ * norm(options_.norm, [&](int l, LocalIndex row) {
           Real const diagonal = operators(l).no_fine.value[operators(l).no_fine.row_start[row]];
           return diagonal * phi_[l][row];
         });
}

void CrsBackend::start(Field& phi, bool /*is_zero*/) {
  result_ = &phi;
  for (int l = 0; l < hierarchy_->level_count(); ++l)
    std::transform(phi.level(l).begin(), phi.level(l).end(), phi_[l].begin(), [&](Real v) { return v / unit_; });
  krylov_ = make_krylov(options_.krylov, equations());
  if (krylov_) find_cells_behind_gaps();
}

void CrsBackend::finish() {
  average_down(phi_);
  for (int l = 0; l < hierarchy_->level_count(); ++l)
    std::transform(phi_[l].begin(), phi_[l].begin() + operators(l).rows(), result_->level(l).begin(),
                   [&](Real v) { return unit_ * v; });
}

/// Covered cells become the mean of their children, and the halo follows: the second cell behind a wall or a
/// coarse-fine face may be a covered one.
void CrsBackend::average_down(CompositeVector& x) const {
  for (int l = hierarchy_->level_count() - 1; l >= 0; --l) {
    if (hierarchy_->has_finer(l)) {
      Crs const& restriction = operators(l).restriction;
      restriction.for_each_row([&](LocalIndex row) {
        if (!operators(l).uncovered[row]) x[l][row] = restriction.dot(row, x[l + 1].data());
      });
    }
    operators(l).halo.update(x[l].data());
  }
}

/// f - A x in the uncovered cells of a level, zero in the others; x is averaged down.
template <class F>
void CrsBackend::subtract(int l, F&& f, CompositeVector const& x, std::vector<Real>& out) const {
  LevelOperators const& o = operators(l);
  Real const* const own = x[l].data();
  for_rows(o.rows(),
           [&, own](LocalIndex row) { out[row] = o.uncovered[row] ? f(row) - o.composite().dot(row, own) : 0.0; });
  if (l > 0) add_multiply(-1.0, o.coarse_boundary, x[l - 1].data(), out.data());
  if (hierarchy_->has_finer(l)) add_multiply(-1.0, o.fine_boundary, x[l + 1].data(), out.data());
}

/// Composite residual of the uncovered cells, into the right-hand sides of the cycle.
void CrsBackend::compute_residual() {
  average_down(phi_);
  for (int l = 0; l < hierarchy_->level_count(); ++l)
    subtract(
        l, [&](LocalIndex row) { return right_hand_side_[l][row]; }, phi_, cycle_level(l).right_hand_side());
}

Real CrsBackend::residual() {
  stopwatch_.time("residual", [&] { compute_residual(); });
  return unit_ * norm(options_.norm, [&](int l, LocalIndex row) { return cycle_level(l).right_hand_side()[row]; });
}

CompositeEquations CrsBackend::equations() {
  auto multiply = [this](CompositeVector& x, CompositeVector& out) {
    average_down(x);
    for (int l = 0; l < hierarchy_->level_count(); ++l) {
      subtract(
          l, [](LocalIndex) { return 0.0; }, x, out[l]);
      for (Real& v : out[l]) v = -v;
    }
  };
  auto dot = [this](CompositeVector const& x, CompositeVector const& y) {
    Real sum = 0;
    for (int l = 0; l < hierarchy_->level_count(); ++l)
      for_each_uncovered(l, [&](LocalIndex row) { sum += x[l][row] * y[l][row]; });
    sum = hierarchy_->comm().sum(sum);
    return sum;
  };
  return {[this] { return zero(); }, multiply, dot};
}

/// One cycle for the residual, and what it gives added to phi.
void CrsBackend::improve() {
  std::size_t const levels = phi_.size();
  CompositeVector values(levels), residual;
  if (krylov_) {
    for (std::size_t l = 0; l < levels; ++l) values[l] = cycle_level(int(l)).right_hand_side();
    CompositeVector const& direction = krylov_->direction(values);
    if (!behind_gaps_.empty()) residual = direction;
    for (std::size_t l = 0; l < levels; ++l)
      std::copy_n(direction[l].begin(), operators(int(l)).rows(), cycle_level(int(l)).right_hand_side().begin());
  }
  multigrid_.cycle(stopwatch_);
  if (krylov_) {
    for (std::size_t l = 0; l < levels; ++l) values[l] = cycle_level(int(l)).correction();
    relax_behind_gaps(residual, values);
    values = krylov_->step(values);
  }
  for (std::size_t l = 0; l < levels; ++l) {
    auto& phi = phi_[l];
    auto const& correction = krylov_ ? values[l] : cycle_level(int(l)).correction();
    for_rows(operators(int(l)).rows(), [&](LocalIndex row) { phi[row] += correction[row]; });
  }
}

void CrsBackend::accelerate() {
  if (krylov_) return;
  krylov_ = make_krylov(KrylovKind::fgmres, equations());
  find_cells_behind_gaps();
}

/// When they are first needed. Collective.
void CrsBackend::find_cells_behind_gaps() {
  if (std::exchange(knows_gaps_, true)) return;
  behind_gaps_ = places_behind_gaps(*hierarchy_, [&](int l, int box, Index3 const& cell) {
    Level const& level = hierarchy_->level(l);
    return level.local_offset(box) + LocalIndex(level.box(box).offset(cell));
  });
}

/// Jacobi steps that become part of a cycle's correction for a residual, see `steps_behind_gaps`.
void CrsBackend::relax_behind_gaps(CompositeVector const& residual, CompositeVector& correction) const {
  if (behind_gaps_.empty()) return;
  std::vector<Real> left;
  for (Real factor : steps_behind_gaps) {
    average_down(correction);
    CompositeVector const before = correction;
    for (std::size_t l = 0; l < before.size(); ++l) {
      left.resize(residual[l].size());
      subtract(
          int(l), [&](LocalIndex row) { return residual[l][std::size_t(row)]; }, before, left);
      Crs const& a = operators(int(l)).no_fine;
      for (std::size_t row : behind_gaps_[l]) correction[l][row] += factor * left[row] / a.value[a.row_start[row]];
    }
  }
}

LevelOperators const& CrsBackend::operators_with_gradient(int level) {
  if (!has_gradient_) {
    assemble_gradient(multigrid_levels_, operators_);
    has_gradient_ = true;
    ++assemblies_;
  }
  return operators(level);
}

ElectricField CrsBackend::electric_field(std::shared_ptr<Field const> potential, CoveredField covered) {
  Field const& phi = *potential;
  std::array<std::shared_ptr<Field>, 3> made;
  std::array<Field*, 3> components;
  for (int axis = 0; axis < 3; ++axis) {
    made[axis] = std::make_shared<Field>(phi.share_hierarchy(), false);
    components[axis] = made[axis].get();
  }
  int const levels = hierarchy_->level_count();
  operators_with_gradient(0);
  for (int l = 0; l < levels; ++l) {
    std::copy(phi.level(l).begin(), phi.level(l).end(), phi_[l].begin());
    operators(l).halo.update(phi_[l].data());
  }
  for (int axis = 0; axis < 3; ++axis) {
    for (int l = 0; l < levels; ++l) {
      LevelOperators const& o = operators(l);
      auto& e = components[axis]->level(l);
      multiply(o.gradient[axis].own, phi_[l].data(), e.data());
      if (l > 0) add_multiply(1.0, o.gradient[axis].coarse, phi_[l - 1].data(), e.data());
      if (l + 1 < levels) add_multiply(1.0, o.gradient[axis].fine, phi_[l + 1].data(), e.data());
      add_to_field(problem_.walls[l], o.walls, hierarchy_->level(l).spacing(), axis, o.uncovered, true, e.data());
    }
  }
  transfer_.average_down({components.begin(), components.end()});
  if (covered == CoveredField::difference) difference_covered(components);
  for (int axis = 0; axis < 3; ++axis)
    for (int l = 0; l < levels && options_.stretch[axis] != 1; ++l)
      for (Real& e : components[axis]->level(l)) e /= options_.stretch[axis];
  return ElectricField({made[0], made[1], made[2]});
}

/// The field in covered cells from the potentials in `phi_`, whose halo is up to date; not yet stretched.
void CrsBackend::difference_covered(std::array<Field*, 3> const& components) {
  if (covered_gradient_.empty())
    for (int l = 0; hierarchy_->has_finer(l); ++l)
      covered_gradient_.push_back(
          assemble_covered_gradient(multigrid_levels_, multigrid_levels_.base + std::size_t(l), operators(l)));
  for (int l = 0; hierarchy_->has_finer(l); ++l)
    for (int axis = 0; axis < 3; ++axis) {
      LevelOperators const& o = operators(l);
      auto& e = components[axis]->level(l);
      Crs const& gradient = covered_gradient_[l][axis];
      gradient.for_each_row([&](LocalIndex row) {
        if (!o.uncovered[row]) e[row] = gradient.dot(row, phi_[l].data());
      });
      add_to_field(problem_.walls[l], o.walls, hierarchy_->level(l).spacing(), axis, o.uncovered, false, e.data());
    }
}

std::size_t CrsBackend::bytes() const {
  std::size_t sum = 0;
  for (MultigridLevel const& level : multigrid_.levels())
    for (auto const* o : level.all_operators()) sum += o->bytes();
  for (auto const& axes : covered_gradient_)
    for (Crs const& axis : axes) sum += axis.bytes();
  return sum;
}

}  // namespace amrpic
