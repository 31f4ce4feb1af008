#include "solver/poisson.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <sstream>

#include "base/error.hpp"
#include "base/rows.hpp"
#include "freespace/density.hpp"
#include "solver/coarsening.hpp"

namespace amrpic {

namespace {

Real global(MPI_Comm comm, Real value, MPI_Op op) {
  MPI_Allreduce(MPI_IN_PLACE, &value, 1, MPI_DOUBLE, op, comm);
  return value;
}

std::string scientific(Real value) {
  std::ostringstream out;
  out.precision(2);
  out << std::scientific << value;
  return out.str();
}

freespace::Lattice lattice_of(Hierarchy const& hierarchy) {
  return {hierarchy.domain().lower, hierarchy.level(0).spacing(), hierarchy.domain().cells};
}

}  // namespace

PoissonSolver::PoissonSolver(std::shared_ptr<Hierarchy const> hierarchy, SolverOptions const& options,
                             Reusable const& reusable)
    : given_(std::move(hierarchy)),
      hierarchy_(given_->stretched(options.stretch)),
      options_(options),
      stack_(coarsen_below(stack_of(*hierarchy_), hierarchy_->domain(), hierarchy_->max_grid_size(),
                           options.coarse_levels)),
      reusable_(reusable),
      operators_(assembled()),
      messages_before_(halo_sum(&Exchange::messages)),
      bytes_before_(halo_sum(&Exchange::bytes)),
      transfer_(hierarchy_),
      multigrid_(hierarchy_->comm(), stack_, operators_, bottom(), options) {
  for (int l = 0; l < hierarchy_->level_count(); ++l) {
    right_hand_side_.emplace_back(std::size_t(operators(l).rows()));
    walls_.push_back(find_walls(hierarchy_->domain(), hierarchy_->level(l)));
  }
  phi_ = zero();
  if (!reusable_.free_space && hierarchy_->domain().has(Boundary::open))
    reusable_.free_space = std::make_shared<freespace::FreeSpace>(hierarchy_->comm(), lattice_of(*hierarchy_));
}

/// The operators, with what was handed on of them.
StackOperators PoissonSolver::assembled() {
  Assembled former;
  if (reusable_.operators) former = std::move(*reusable_.operators);
  reusable_.operators =
      std::make_shared<Assembled>(assemble(hierarchy_->comm(), stack_, options_.prolongation, std::move(former)));
  levels_assembled_ = reusable_.operators->made;
  return reusable_.operators->operators;
}

/// The bottom that was handed on if it serves, else a new one.
std::shared_ptr<Bottom> PoissonSolver::bottom() {
  if (!reusable_.bottom || !reusable_.bottom->serves(*operators_.front())) {
    reusable_.bottom.reset();  // the old one goes before the new one comes
    reusable_.bottom =
        std::make_shared<Bottom>(hierarchy_->comm(), *operators_.front(), hierarchy_->domain().singular(), options_);
    ++bottom_setups_;
  }
  return reusable_.bottom;
}

/// Zeros on all levels, with room for ghosts.
Composite PoissonSolver::zero() const {
  Composite out;
  for (int l = 0; l < hierarchy_->level_count(); ++l)
    out.emplace_back(std::size_t(operators(l).rows()) + std::size_t(operators(l).halo.ghosts()));
  return out;
}

/// The chosen norm over uncovered cells of the whole hierarchy of value(level, row); nan if one is.
template <class Value>
Real PoissonSolver::norm(Value&& value) const {
  bool const largest = options_.norm == Norm::max;
  Real result = 0;
  for (int l = 0; l < hierarchy_->level_count(); ++l) {
    Real const volume = given_->level(l).cell_volume();  // as it is, for the absolute tolerance
    for_each_uncovered(l, [&](LocalIndex row) {
      Real const v = std::abs(value(l, row));
      if (largest)
        result = v <= result || std::isnan(result) ? result : v;  // a nan stays
      else
        result += volume * (options_.norm == Norm::l1 ? v : v * v);
    });
  }
  return global_norm(hierarchy_->comm(), options_.norm, result);
}

/// Integral of the right-hand side, or of its magnitude, over uncovered cells.
Real PoissonSolver::composite_integral(bool magnitude) const {
  Real sum = 0;
  for (int l = 0; l < hierarchy_->level_count(); ++l) {
    Real const volume = hierarchy_->level(l).cell_volume();
    for_each_uncovered(l, [&](LocalIndex row) {
      Real const f = right_hand_side_[l][row];
      sum += volume * (magnitude ? std::abs(f) : f);
    });
  }
  return global(hierarchy_->comm(), sum, MPI_SUM);
}

/// Size of the largest single term in the residual: what rounding is relative to.
Real PoissonSolver::largest_phi_term() const {
  return norm([&](int l, LocalIndex row) {
    Real const diagonal = operators(l).no_fine.value[operators(l).no_fine.row_start[row]];
    return diagonal * phi_[l][row];
  });
}

void PoissonSolver::set_open_walls(Field const& rho) {
  Domain const& domain = hierarchy_->domain();
  reusable_.free_space->set_charges(freespace::charges_of(rho, *hierarchy_, 1 / vacuum_permittivity));

  std::array<bool, 6> open;
  for (int face = 0; face < 6; ++face) open[face] = domain.boundary[face / 2][face % 2] == Boundary::open;
  auto const planes = reusable_.free_space->wall_planes(open);
  std::vector<freespace::PointTarget> targets;
  std::vector<Real*> datum;
  for (int l = 0; l < hierarchy_->level_count(); ++l)
    for (std::size_t i = 0; i < walls_[l].faces.size(); ++i) {
      auto const& face = walls_[l].faces[i];
      if (face.kind != Boundary::open) continue;
      if (l == 0) {
        auto const [u, v] = tangential_axes(face.axis);
        walls_[0].datum[i] =
            planes[2 * face.axis + face.side][std::size_t(face.cell[u]) + std::size_t(domain.cells[u]) * face.cell[v]];
      } else {
        targets.push_back({walls_[l].position(domain, hierarchy_->level(l), i), l});
        datum.push_back(&walls_[l].datum[i]);
      }
    }
  auto const values = reusable_.free_space->potential(targets);
  for (std::size_t t = 0; t < values.size(); ++t) *datum[t] = values[t];
}

void PoissonSolver::set_right_hand_side(Field const& rho) {
  for (int l = 0; l < hierarchy_->level_count(); ++l) {
    auto& f = right_hand_side_[l];
    auto const& density = rho.level(l);
    for_rows(operators(l).rows(), [&](LocalIndex row) { f[row] = -density[row] / vacuum_permittivity; });
    subtract_from_laplacian(walls_[l], operators(l).walls, hierarchy_->level(l).spacing(), f);
  }
}

/// Where constants are in the null space, only a right-hand side without mean has a solution.
void PoissonSolver::remove_net_charge() {
  Real volume = 1;
  for (int d = 0; d < 3; ++d) volume *= hierarchy_->domain().upper[d] - hierarchy_->domain().lower[d];
  Real const net = composite_integral(false), magnitude = composite_integral(true);
  Real const stretched_volume = options_.stretch[0] * options_.stretch[1] * options_.stretch[2];
  if (!options_.neutralize && std::abs(net) > 1e-10 * magnitude)
    throw SolverError("all faces are periodic or Neumann, but the net charge (with the flux through the walls) is " +
                      scientific(-net / stretched_volume * vacuum_permittivity) +
                      " C, which no potential can balance; make it zero, ask for background = \"neutralizing\", or "
                      "give one face a potential");
  // Twice: what rounding leaves of a large uniform background is a mean that no potential can balance, and it would
  // stop the residual where little else remains, as between two swings of a plasma.
  for (int pass = 0; pass < 2; ++pass) {
    Real const mean = composite_integral(false) / volume;
    for (int l = 0; l < hierarchy_->level_count(); ++l)
      for (Real& f : right_hand_side_[l]) f -= mean;
  }
}

/// Covered cells become the mean of their children, and ghosts follow: the second cell behind a wall or a coarse-fine
/// face may be a covered one.
void PoissonSolver::average_down(Composite& x) const {
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
void PoissonSolver::subtract(int l, F&& f, Composite const& x, std::vector<Real>& out) const {
  LevelOperators const& o = operators(l);
  Real const* const own = x[l].data();
  for_rows(o.rows(),
           [&, own](LocalIndex row) { out[row] = o.uncovered[row] ? f(row) - o.composite().dot(row, own) : 0.0; });
  if (l > 0) add_multiply(-1.0, o.coarse_boundary, x[l - 1].data(), out.data());
  if (hierarchy_->has_finer(l)) add_multiply(-1.0, o.fine_boundary, x[l + 1].data(), out.data());
}

/// Composite residual of the uncovered cells, into the right-hand sides of the cycle.
void PoissonSolver::compute_residual() {
  average_down(phi_);
  for (int l = 0; l < hierarchy_->level_count(); ++l)
    subtract(
        l, [&](LocalIndex row) { return right_hand_side_[l][row]; }, phi_, cycle_level(l).right_hand_side());
}

Real PoissonSolver::residual_norm() {
  return norm([&](int l, LocalIndex row) { return cycle_level(l).right_hand_side()[row]; });
}

CompositeEquations PoissonSolver::equations() {
  auto multiply = [this](Composite& x, Composite& out) {
    average_down(x);
    for (int l = 0; l < hierarchy_->level_count(); ++l) {
      subtract(
          l, [](LocalIndex) { return 0.0; }, x, out[l]);
      for (Real& v : out[l]) v = -v;
    }
  };
  auto dot = [this](Composite const& x, Composite const& y) {
    Real sum = 0;
    for (int l = 0; l < hierarchy_->level_count(); ++l)
      for_each_uncovered(l, [&](LocalIndex row) { sum += x[l][row] * y[l][row]; });
    return global(hierarchy_->comm(), sum, MPI_SUM);
  };
  return {[this] { return zero(); }, multiply, dot};
}

/// One cycle for the residual, and what it gives added to phi; `krylov` may be null.
void PoissonSolver::improve(Krylov* krylov) {
  std::size_t const levels = phi_.size();
  Composite values(levels);
  if (krylov) {
    for (std::size_t l = 0; l < levels; ++l) values[l] = cycle_level(int(l)).right_hand_side();
    Composite const& direction = krylov->direction(values);
    for (std::size_t l = 0; l < levels; ++l)
      std::copy_n(direction[l].begin(), operators(int(l)).rows(), cycle_level(int(l)).right_hand_side().begin());
  }
  multigrid_.cycle();
  if (krylov) {
    for (std::size_t l = 0; l < levels; ++l) values[l] = cycle_level(int(l)).correction();
    values = krylov->step(values);
  }
  for (std::size_t l = 0; l < levels; ++l) {
    auto& phi = phi_[l];
    auto const& correction = krylov ? values[l] : cycle_level(int(l)).correction();
    for_rows(operators(int(l)).rows(), [&](LocalIndex row) { phi[row] += correction[row]; });
  }
}

/// Take the mean over the domain away from phi, where the boundary leaves it free.
void PoissonSolver::fix_constant() {
  Real sum = 0, volume = 0;
  for (int l = 0; l < hierarchy_->level_count(); ++l)
    for_each_uncovered(l, [&](LocalIndex row) {
      sum += hierarchy_->level(l).cell_volume() * phi_[l][row];
      volume += hierarchy_->level(l).cell_volume();
    });
  Real const mean = global(hierarchy_->comm(), sum, MPI_SUM) / global(hierarchy_->comm(), volume, MPI_SUM);
  for (auto& level : phi_)
    for (Real& phi : level) phi -= mean;
}

void PoissonSolver::iterate(SolveReport& report) {
  Real const size = norm([&](int l, LocalIndex row) { return right_hand_side_[l][row]; });
  if (!std::isfinite(size))
    throw SolverError(
        "the charge density or the boundary data hold values that are not finite; look for the step that made them");
  auto finish = [&](bool converged, std::string reason) {
    report.converged = converged;
    report.reason = std::move(reason);
  };
  if (size == 0) {
    for (auto& level : phi_) std::fill(level.begin(), level.end(), 0.0);
    report.residuals.push_back(0);
    return finish(true, "the right-hand side is zero");
  }
  auto const krylov = make_krylov(options_.krylov, equations());
  int slow = 0, stuck = 0;  // cycles in a row that halved the residual not even once, or hardly moved it
  for (;; ++report.cycles) {
    stopwatch_.time("residual", [&] { compute_residual(); });
    Real const residual = residual_norm() / size;
    report.residuals.push_back(residual);
    if (residual <= options_.tolerance) return finish(true, "tolerance reached");
    if (residual * size <= options_.absolute_tolerance) return finish(true, "absolute tolerance reached");
    if (!std::isfinite(residual) && report.cycles == 0)
      throw SolverError("the guess holds values that are not finite; solve without one");
    if (!std::isfinite(residual)) return finish(false, "the residual is not finite");
    if (residual > 1e6 * std::max(report.residuals.front(), Real(1))) return finish(false, "the cycles diverge");
    if (options_.to_discretisation && report.cycles > 0 && below_discretisation(report))
      return finish(true, "error left is below a tenth of the estimated " + scientific(report.discretisation_error) +
                              " V of the mesh");
    if (report.cycles > 0) {
      Real const factor = residual / report.residuals[report.residuals.size() - 2];
      slow = factor > 0.5 ? slow + 1 : 0;
      stuck = factor > 0.98 ? stuck + 1 : 0;
    }
    if (slow >= 2) {
      report.floor = std::numeric_limits<Real>::epsilon() * largest_phi_term() / size;
      if (residual <= 10 * report.floor)
        return finish(options_.tolerance <= 10 * report.floor,
                      "rounding floor of about " + scientific(report.floor) + " reached");
    }
    if (stuck >= 5) return finish(false, "the residual no longer falls");
    if (report.cycles == options_.max_cycles)
      return finish(false, "no convergence in " + std::to_string(options_.max_cycles) + " cycles");
    improve(krylov.get());
    if (options_.to_discretisation) {
      correction_before_ = report.cycles > 0 ? latest_correction_ : std::numeric_limits<Real>::infinity();
      latest_correction_ = largest_correction();
    }
  }
}

/// Whether what the cycles to come would still change is a tenth of the error of the mesh: the latest correction times
/// the sum of the geometric series that they make.
bool PoissonSolver::below_discretisation(SolveReport& report) {
  Real const residual = report.residuals.back(), before = report.residuals[report.residuals.size() - 2];
  if (report.discretisation_error == 0)
    stopwatch_.time("discretisation error", [&] { report.discretisation_error = discretisation_error(); });
  // The residual may fall faster than the error at first; no cycle gains more than a digit for good.
  Real const factor = std::max({residual / before, latest_correction_ / correction_before_, Real(0.1)});
  return factor < 0.9 && latest_correction_ * factor / (1 - factor) <= 0.1 * report.discretisation_error;
}

SolveReport PoissonSolver::solve(Field const& rho, Field& phi) {
  SolveReport report;
  stopwatch_.reset();
  multigrid_.stopwatch().reset();
  if (reusable_.free_space) stopwatch_.time("open boundary", [&] { set_open_walls(rho); });
  set_right_hand_side(rho);
  bool const singular = hierarchy_->domain().singular();
  if (singular) remove_net_charge();
  for (int l = 0; l < hierarchy_->level_count(); ++l)
    std::copy(phi.level(l).begin(), phi.level(l).end(), phi_[l].begin());

  iterate(report);

  if (singular) fix_constant();
  average_down(phi_);
  for (int l = 0; l < hierarchy_->level_count(); ++l)
    std::copy(phi_[l].begin(), phi_[l].begin() + operators(l).rows(), phi.level(l).begin());
  report.seconds = stopwatch_.seconds();
  for (auto const& [stage, seconds] : multigrid_.stopwatch().seconds()) report.seconds[stage] = seconds;
  return report;
}

LevelOperators const& PoissonSolver::operators_with_gradient(int level) {
  if (!has_gradient_) {
    assemble_gradient(stack_, operators_);
    has_gradient_ = true;
    ++assemblies_;
  }
  return operators(level);
}

void PoissonSolver::electric_field(Field const& phi, std::vector<Field*> const& components, CoveredField covered) {
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
      add_to_field(walls_[l], o.walls, hierarchy_->level(l).spacing(), axis, o.uncovered, true, e);
    }
  }
  transfer_.average_down(components);
  if (covered == CoveredField::difference) difference_covered(components);
  for (int axis = 0; axis < 3; ++axis)
    for (int l = 0; l < levels && options_.stretch[axis] != 1; ++l)
      for (Real& e : components[axis]->level(l)) e /= options_.stretch[axis];
}

/// The field in covered cells from the potentials in `phi_`, whose ghosts are up to date; not yet stretched.
void PoissonSolver::difference_covered(std::vector<Field*> const& components) {
  if (covered_gradient_.empty())
    for (int l = 0; hierarchy_->has_finer(l); ++l)
      covered_gradient_.push_back(assemble_covered_gradient(stack_, stack_.base + std::size_t(l), operators(l)));
  for (int l = 0; hierarchy_->has_finer(l); ++l)
    for (int axis = 0; axis < 3; ++axis) {
      LevelOperators const& o = operators(l);
      auto& e = components[axis]->level(l);
      Crs const& gradient = covered_gradient_[l][axis];
      gradient.for_each_row([&](LocalIndex row) {
        if (!o.uncovered[row]) e[row] = gradient.dot(row, phi_[l].data());
      });
      add_to_field(walls_[l], o.walls, hierarchy_->level(l).spacing(), axis, o.uncovered, false, e);
    }
}

std::int64_t PoissonSolver::halo_sum(std::int64_t (Exchange::*of)() const) const {
  std::int64_t sum = 0;
  for (auto const& o : operators_) sum += (o->halo.*of)() + (o->stencil_halo.*of)();
  return sum;
}

std::size_t PoissonSolver::operator_bytes() const {
  std::size_t sum = 0;
  for (auto const& o : operators_) sum += o->bytes();
  for (auto const& axes : covered_gradient_)
    for (Crs const& axis : axes) sum += axis.bytes();
  return sum;
}

}  // namespace amrpic
