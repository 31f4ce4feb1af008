#include "solver/crs_backend.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <utility>

#include "solver/behind_gaps.hpp"

namespace amrpic {

namespace {

using Rows = TpetraTypes::Rows;

Rows rows_of(DeviceArray<char> const& mask) { return Rows(0, LocalIndex(mask.extent(0))); }

/// The largest magnitude where the mask is set, as `Largest` finds it.
Real largest_of(DeviceArray<char> const& mask, DeviceArray<Real const> const& x) {
  std::int64_t bits = 0;
  Kokkos::parallel_reduce(
      "largest", rows_of(mask),
      KOKKOS_LAMBDA(LocalIndex row, std::int64_t & most) {
        std::int64_t of_row;
        std::memcpy(&of_row, &x(row), sizeof of_row);
        of_row &= std::numeric_limits<std::int64_t>::max();
        if (mask(row) && of_row > most) most = of_row;
      },
      Kokkos::Max<std::int64_t>(bits));
  Real out;
  std::memcpy(&out, &bits, sizeof out);
  return out;
}

/// The sum of the magnitudes of factor times each value where the mask is set, or of their squares.
Real sum_of(DeviceArray<char> const& mask, DeviceArray<Real const> const& x, Real factor, bool squares) {
  Real out = 0;
  Kokkos::parallel_reduce(
      "sum", rows_of(mask),
      KOKKOS_LAMBDA(LocalIndex row, Real & sum) {
        Real const v = factor * x(row);
        if (mask(row)) sum += squares ? v * v : v < 0 ? -v : v;
      },
      out);
  return out;
}

/// Of values that are zero in covered cells, over own cells.
Real product(LevelVector const& x, LevelVector const& y) {
  auto const a = x.values(), b = y.values();
  Real out = 0;
  Kokkos::parallel_reduce(
      "product", Rows(0, x.cells().rows()), KOKKOS_LAMBDA(LocalIndex row, Real & sum) { sum += a(row) * b(row); }, out);
  return out;
}

/// out = diagonal of A times x.
void multiply_by_diagonal(TpetraTypes::LocalMatrix const& a, DeviceArray<Real const> const& x,
                          DeviceArray<Real> const& out) {
  Kokkos::parallel_for(
      "diagonal", Rows(0, a.numRows()),
      KOKKOS_LAMBDA(LocalIndex row) { out(row) = a.values(a.graph.row_map(row)) * x(row); });
}

/// out += factor x / diagonal of A in some rows. The diagonal comes first in each row.
void add_over_diagonal(DeviceArray<LocalIndex> const& rows, TpetraTypes::LocalMatrix const& a, Real factor,
                       DeviceArray<Real const> const& x, DeviceArray<Real> const& out) {
  Kokkos::parallel_for(
      "over diagonal", Rows(0, LocalIndex(rows.extent(0))), KOKKOS_LAMBDA(LocalIndex n) {
        LocalIndex const row = rows(n);
        out(row) += factor * x(row) / a.values(a.graph.row_map(row));
      });
}

}  // namespace

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
  phi_ = zero();
  right_hand_side_ = zero();
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

CompositeVector CrsBackend::zero() const {
  CompositeVector out;
  for (int l = 0; l < hierarchy_->level_count(); ++l) out.emplace_back(operators(l).cells);
  return out;
}

/// A norm over uncovered cells of the whole hierarchy of vector_of(level); nan if a value is not finite.
Real CrsBackend::norm(Norm norm, std::function<LevelVector const&(int)> const& vector_of) const {
  Magnitude magnitude(norm);
  for (int l = 0; l < hierarchy_->level_count(); ++l) {
    auto const& mask = *operators(l).mask;
    LevelVector const& vector = vector_of(l);
    auto const values = vector.values();
    magnitude.add_by([&] { return largest_of(mask, values); },
                     [&](Real factor) { return sum_of(mask, values, factor, magnitude.sums_squares()); },
                     problem_.given->level(l).cell_volume());  // as it is, for the absolute tolerance
  }
  return magnitude.over(hierarchy_->comm());
}

Integral CrsBackend::integrate_right_hand_side() {
  std::array<Real, 2> sums{};
  for (int l = 0; l < hierarchy_->level_count(); ++l) {
    LevelOperators const& o = operators(l);
    auto const& rho = rho_->level(l);
    std::vector<Real> f(rho.size()), of_walls(rho.size());
    copy_out(right_hand_side_[std::size_t(l)].own(), f);
    subtract_from_laplacian(problem_.walls[l], o.walls, equation(l), of_walls);
    Real net = 0, size = 0;
    for (LocalIndex row = 0; row < o.rows(); ++row) {
      if (!o.uncovered[row]) continue;
      net += f[row];
      size +=
          Background::inverse_permittivity * std::abs(rho[row]) + std::abs(background_.mean) + std::abs(of_walls[row]);
    }
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
    LevelOperators const& o = operators(l);
    auto const& density = rho_->level(l);
    std::vector<Real> f(density.size());
    std::transform(density.begin(), density.end(), f.begin(), [&](Real v) { return background.right_hand_side(v); });
    subtract_from_laplacian(problem_.walls[l], o.walls, equation(l), f);
    for (LocalIndex row = 0; row < o.rows(); ++row)
      if (!o.uncovered[row]) f[row] = 0;
    copy_in(f, right_hand_side_[std::size_t(l)].own());
  }
}

/// From here on the vectors are of the order of one, whose squares a Krylov method may sum up.
Real CrsBackend::largest_right_hand_side() {
  Real const largest = norm(
      Norm::max, [&](int l) -> auto const& { return right_hand_side_[std::size_t(l)]; });
  unit_ = std::isnormal(largest) ? std::ldexp(1.0, std::ilogb(largest)) : 1;
  for (LevelVector& level : right_hand_side_) level.own().scale(1 / unit_);
  return largest;
}

Real CrsBackend::right_hand_side_norm() {
  return unit_ * norm(
                     options_.norm, [&](int l) -> auto const& { return right_hand_side_[std::size_t(l)]; });
}

Real CrsBackend::largest_phi_term() {
  CompositeVector terms = zero();
  for (int l = 0; l < hierarchy_->level_count(); ++l)
    multiply_by_diagonal(operators(l).no_fine.matrix()->getLocalMatrixDevice(),
                         std::as_const(phi_[std::size_t(l)]).values(), terms[std::size_t(l)].values());
  return unit_ * norm(
                     options_.norm, [&](int l) -> auto const& { return terms[std::size_t(l)]; });
}

void CrsBackend::start(Field& phi, bool /*is_zero*/) {
  result_ = &phi;
  for (int l = 0; l < hierarchy_->level_count(); ++l) {
    auto& own = phi_[std::size_t(l)].own();
    copy_in(phi.level(l), own);
    own.scale(1 / unit_);
  }
  krylov_ = make_krylov(options_.krylov, equations());
  if (krylov_) find_cells_behind_gaps();
}

void CrsBackend::finish() {
  average_down(phi_);
  for (int l = 0; l < hierarchy_->level_count(); ++l) {
    auto& own = phi_[std::size_t(l)].own();
    own.scale(unit_);
    copy_out(own, result_->level(l));
  }
}

/// Covered cells become the mean of their children, and the halo follows: the second cell behind a wall or a
/// coarse-fine face may be a covered one.
void CrsBackend::average_down(CompositeVector& x) const {
  for (int l = hierarchy_->level_count() - 1; l >= 0; --l) {
    LevelVector& level = x[std::size_t(l)];
    if (hierarchy_->has_finer(l)) operators(l).restriction.set_rows(x[std::size_t(l) + 1], level);
    level.update_halo();
  }
}

/// Add scale A x to values of a level, in its uncovered cells; x is averaged down.
void CrsBackend::multiply(CompositeVector const& x, int l, Real scale, LevelVector& out) const {
  LevelOperators const& o = operators(l);
  std::size_t const level = std::size_t(l);
  o.composite().add(scale, x[level], out);
  if (l > 0) o.coarse_boundary.add(scale, x[level - 1], out);
  if (hierarchy_->has_finer(l)) o.fine_boundary.add(scale, x[level + 1], out);
}

/// Composite residual of the uncovered cells, into the right-hand sides of the cycle; zero in covered ones.
void CrsBackend::compute_residual() {
  average_down(phi_);
  for (int l = 0; l < hierarchy_->level_count(); ++l) {
    LevelVector& out = cycle_level(l).right_hand_side();
    out.assign(right_hand_side_[std::size_t(l)]);
    multiply(phi_, l, -1, out);
  }
}

Real CrsBackend::residual() {
  stopwatch_.time("residual", [&] { compute_residual(); });
  return unit_ * norm(
                     options_.norm, [&](int l) -> auto const& { return cycle_level(l).right_hand_side(); });
}

CompositeEquations CrsBackend::equations() {
  auto multiply_all = [this](CompositeVector& x, CompositeVector& out) {
    average_down(x);
    for (int l = 0; l < hierarchy_->level_count(); ++l) {
      out[std::size_t(l)].set_zero();
      multiply(x, l, 1, out[std::size_t(l)]);
    }
  };
  auto dot = [this](CompositeVector const& x, CompositeVector const& y) {
    Real sum = 0;
    for (std::size_t l = 0; l < x.size(); ++l) sum += product(x[l], y[l]);
    return hierarchy_->comm().sum(sum);
  };
  return {[this] { return zero(); }, multiply_all, dot};
}

/// One cycle for the residual, and what it gives added to phi.
void CrsBackend::improve() {
  std::size_t const levels = phi_.size();
  if (!krylov_) {
    multigrid_.cycle(stopwatch_);
    for (std::size_t l = 0; l < levels; ++l) phi_[l].own().update(1, cycle_level(int(l)).correction().own(), 1);
    return;
  }
  CompositeVector values = zero();
  for (std::size_t l = 0; l < levels; ++l) values[l].assign(cycle_level(int(l)).right_hand_side());
  CompositeVector const& direction = krylov_->direction(values);
  for (std::size_t l = 0; l < levels; ++l) cycle_level(int(l)).right_hand_side().assign(direction[l]);
  multigrid_.cycle(stopwatch_);
  for (std::size_t l = 0; l < levels; ++l) values[l].assign(cycle_level(int(l)).correction());
  relax_behind_gaps(direction, values);
  CompositeVector const& step = krylov_->step(values);
  for (std::size_t l = 0; l < levels; ++l) phi_[l].own().update(1, step[l].own(), 1);
}

void CrsBackend::accelerate() {
  if (krylov_) return;
  krylov_ = make_krylov(KrylovKind::fgmres, equations());
  find_cells_behind_gaps();
}

/// When they are first needed. Collective.
void CrsBackend::find_cells_behind_gaps() {
  if (std::exchange(knows_gaps_, true)) return;
  auto const rows = each_behind_gaps(*hierarchy_, [&](int l, int box, Index3 const& cell) {
    Level const& level = hierarchy_->level(l);
    return level.local_offset(box) + LocalIndex(level.box(box).offset(cell));
  });
  for (auto const& of_level : rows) behind_gaps_.emplace_back(on_device(of_level));
}

/// Jacobi steps that become part of a cycle's correction for a residual, see `steps_behind_gaps`.
void CrsBackend::relax_behind_gaps(CompositeVector const& residual, CompositeVector& correction) const {
  if (behind_gaps_.empty()) return;
  CompositeVector left = zero();
  for (Real factor : steps_behind_gaps) {
    average_down(correction);
    for (std::size_t l = 0; l < left.size(); ++l) {
      left[l].assign(residual[l]);
      multiply(correction, int(l), -1, left[l]);
    }
    for (std::size_t l = 0; l < left.size(); ++l)
      add_over_diagonal(*behind_gaps_[l], operators(int(l)).no_fine.matrix()->getLocalMatrixDevice(), factor,
                        std::as_const(left[l]).values(), correction[l].values());
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
    copy_in(phi.level(l), phi_[std::size_t(l)].own());
    phi_[std::size_t(l)].update_halo();
  }
  for (int l = 0; l < levels; ++l) {
    LevelOperators const& o = operators(l);
    std::size_t const level = std::size_t(l);
    LevelVector e(o.cells);
    for (int axis = 0; axis < 3; ++axis) {
      GradientAxis const& gradient = o.gradient[std::size_t(axis)];
      gradient.own.multiply(phi_[level], e);
      if (l > 0) gradient.coarse.add(1, phi_[level - 1], e);
      if (l + 1 < levels) gradient.fine.add(1, phi_[level + 1], e);
      auto& component = components[std::size_t(axis)]->level(l);
      copy_out(e.own(), component);
      add_to_field(problem_.walls[l], o.walls, hierarchy_->level(l).spacing(), axis, o.uncovered, true,
                   component.data());
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
  for (int l = 0; hierarchy_->has_finer(l); ++l) {
    LevelOperators const& o = operators(l);
    LevelVector differences(o.cells);
    std::vector<Real> found(std::size_t(o.rows()));
    for (int axis = 0; axis < 3; ++axis) {
      auto& e = components[std::size_t(axis)]->level(l);
      covered_gradient_[std::size_t(l)][std::size_t(axis)].multiply(phi_[std::size_t(l)], differences);
      copy_out(differences.own(), found);
      for (LocalIndex row = 0; row < o.rows(); ++row)
        if (!o.uncovered[row]) e[row] = found[row];
      add_to_field(problem_.walls[l], o.walls, hierarchy_->level(l).spacing(), axis, o.uncovered, false, e.data());
    }
  }
}

std::size_t CrsBackend::bytes() const {
  std::size_t sum = 0;
  for (MultigridLevel const& level : multigrid_.levels())
    for (auto const* o : level.all_operators()) sum += o->bytes();
  for (auto const& axes : covered_gradient_)
    for (SparseMatrix const& axis : axes) sum += axis.bytes();
  return sum;
}

}  // namespace amrpic
