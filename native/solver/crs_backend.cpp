#include <memory>
#include <optional>
#include <utility>

#include "matrices/operators.hpp"
#include "mesh/norm.hpp"
#include "multigrid/nearly_free.hpp"
#include "solver/backend.hpp"
#include "solver/bicgstab.hpp"
#include "solver/compressed_rows.hpp"
#include "solver/multigrid.hpp"

namespace amrpic {

namespace {

/// The eight operators of each level as compressed rows, with the solver's whole menu: residuals are those of the
/// matrices, and so is the cycle, in double precision. All else is the matrix-free backend's. Where that combines
/// corrections, or estimates the error of the mesh, they pass through its vectors, which are of single precision.
class CrsBackend : public Backend {
 public:
  /// `reusable`: of a solver of the same options, or empty; becomes what is in use. Collective.
  CrsBackend(Problem const& problem, Reusable& reusable)
      : Backend(problem),
        hierarchy_(*problem.hierarchy),
        multigrid_levels_(coarsen_below(refinement_levels(hierarchy_, shift_of(problem.options)), hierarchy_.domain(),
                                        {hierarchy_.max_grid_size()}, problem.options.coarse_levels)),
        operators_(assembled(reusable)),
        multigrid_(hierarchy_.comm(), multigrid_levels_, operators_, bottom(reusable), hierarchy_.max_grid_size(),
                   problem.options, problem.metal.get()),
        values_(zero()) {
    if (!composite_.has_residual_of_zero()) nothing_.emplace(problem.hierarchy);
    if (problem.options.krylov == KrylovKind::bicgstab) bicgstab_.emplace(equations());
  }

  void start(Field& phi, bool is_zero) override {
    Backend::start(phi, is_zero);
    in_single_ = false;
    if (bicgstab_) bicgstab_->restart();
    if (problem_.options.krylov == KrylovKind::fgmres) accelerate();
  }
  void accelerate() override {
    if (bicgstab_) return;  // by which cycles are accelerated already
    Backend::accelerate();
    in_single_ = true;
  }
  Real discretisation_error() override {
    bool const before = std::exchange(in_single_, true);
    Real const out = Backend::discretisation_error();
    in_single_ = before;
    find_residual();  // which a cycle has taken the place of
    return out;
  }

  LevelOperators const& operators_with_gradient(int level) override {
    if (!std::exchange(has_gradient_, true)) assemble_gradient(multigrid_levels_, operators_);
    return operators(level);
  }
  std::int64_t assemblies() const override { return has_gradient_ ? 2 : 1; }
  std::int64_t bottom_setups() const override { return bottom_setups_; }
  std::int64_t levels_assembled() const override { return levels_assembled_; }
  std::size_t bytes() const override {
    std::size_t sum = Backend::bytes();
    for (MultigridLevel const& level : multigrid_.levels()) sum += level.operators->bytes();
    return sum;
  }

 protected:
  Real find_residual() override;
  void run_cycle() override;
  Real add_correction(Real scale) override {
    if (in_single_) return Backend::add_correction(scale);
    return composite_.add(blocks(&MultigridLevel::correction), scale / unit_of_correction(), *phi_);
  }

 private:
  LevelOperators const& operators(int level) const { return *operators_[multigrid_levels_.base + std::size_t(level)]; }
  MultigridLevel& cycle_level(int l) { return multigrid_.level(multigrid_levels_.base + std::size_t(l)); }
  /// What a correction of this cycle is divided by to be one of the matrix-free cycle. Here residuals are scaled by
  /// `scale_[0]` on all levels, so that both cycles have equal ones on the base, apart from its spacing squared.
  Real unit_of_correction() { return cycle_.level(0).scale(); }

  MultigridOperators assembled(Reusable& reusable);
  Mean holds_mean() const;
  std::shared_ptr<Bottom> bottom(Reusable& reusable);
  CompositeVector zero() const;
  void average_down(CompositeVector& x) const;
  void multiply(CompositeVector const& x, int l, Real scale, LevelVector& out) const;
  CompositeEquations equations();
  Blocks<Real> blocks(LevelVector MultigridLevel::*vector);
  void replace(LevelVector MultigridLevel::*vector, CompositeVector const& (BiCgStab::*make)(CompositeVector const&));
  template <class F>
  void for_each_pair(Blocks<float> const& single, LevelVector MultigridLevel::*vector, F&& f);

  Hierarchy const& hierarchy_;
  MultigridLevels multigrid_levels_;
  std::int64_t levels_assembled_ = 0;
  MultigridOperators operators_;
  std::int64_t bottom_setups_ = 0;
  Multigrid multigrid_;
  CompositeVector values_;  ///< under way
  std::optional<BiCgStab> bicgstab_;
  bool in_single_ = false;  ///< whether the matrix-free backend's vectors give the residual and take the correction
  bool has_gradient_ = false;
  std::optional<Field> nothing_;  ///< a potential of zero, where data make more of its residual than right-hand sides
};

/// The operators; those that can be are taken over. Beside metal none is, as where it is may be other.
MultigridOperators CrsBackend::assembled(Reusable& reusable) {
  Assembled former;
  if (reusable.operators) former = std::move(*reusable.operators);
  if (problem_.metal) former = {};
  auto const assembled = std::make_shared<Assembled>(assemble(
      hierarchy_.comm(), multigrid_levels_, problem_.options.prolongation, std::move(former), problem_.metal.get()));
  reusable.operators = problem_.metal ? nullptr : assembled;
  levels_assembled_ = assembled->made;
  return assembled->operators;
}

/// Of shifts below a thousandth of the next eigenvalue what is lost by leaving them out is gone with the next cycle.
Mean CrsBackend::holds_mean() const {
  Level const& base = hierarchy_.level(0);
  Faces const& boundary = hierarchy_.domain().boundary;
  Real const shift = shift_of(problem_.options);
  if (problem_.metal || !is_mean_left_free(base, boundary, shift)) return Mean::equation;
  return shift <= 1e-3 * smallest_eigenvalue(base, boundary, 0) ? Mean::nothing : Mean::others;
}

/// The bottom that was taken over if it serves, else a new one.
std::shared_ptr<Bottom> CrsBackend::bottom(Reusable& reusable) {
  if (!reusable.bottom || !reusable.bottom->serves(*operators_.front())) {
    reusable.bottom.reset();  // the old one goes before the new one comes
    reusable.bottom = std::make_shared<Bottom>(hierarchy_.comm(), *operators_.front(), holds_mean(), problem_.options);
    ++bottom_setups_;
  }
  return reusable.bottom;
}

CompositeVector CrsBackend::zero() const {
  CompositeVector out;
  for (int l = 0; l < hierarchy_.level_count(); ++l) out.emplace_back(operators(l).cells);
  return out;
}

/// Covered cells become the mean of their children, and the halo follows: the second cell behind a wall or a
/// coarse-fine face may be a covered one.
void CrsBackend::average_down(CompositeVector& x) const {
  for (int l = hierarchy_.level_count() - 1; l >= 0; --l) {
    LevelVector& level = x[std::size_t(l)];
    if (hierarchy_.has_finer(l)) operators(l).restriction.set_rows(x[std::size_t(l) + 1], level);
    level.update_halo();
  }
}

/// Add scale A x to values of a level, in its uncovered cells; x is averaged down.
void CrsBackend::multiply(CompositeVector const& x, int l, Real scale, LevelVector& out) const {
  LevelOperators const& o = operators(l);
  std::size_t const level = std::size_t(l);
  o.composite().add(scale, x[level], out);
  if (l > 0) o.coarse_boundary.add(scale, x[level - 1], out);
  if (hierarchy_.has_finer(l)) o.fine_boundary.add(scale, x[level + 1], out);
}

CompositeEquations CrsBackend::equations() {
  auto multiply_all = [this](CompositeVector& x, CompositeVector& out) {
    average_down(x);
    for (int l = 0; l < hierarchy_.level_count(); ++l) {
      out[std::size_t(l)].set_zero();
      multiply(x, l, 1, out[std::size_t(l)]);
    }
  };
  return {[this] { return zero(); }, multiply_all};
}

/// Where the boxes' cells lie in a vector of the cycle, on the host.
Blocks<Real> CrsBackend::blocks(LevelVector MultigridLevel::*vector) {
  CompositeMesh const& mesh = composite_.mesh();
  Blocks<Real> out(std::size_t(mesh.levels()));
  std::vector<Real*> values;
  for (int l = 0; l < mesh.levels(); ++l)
    values.push_back((cycle_level(l).*vector).own().getLocalViewHost(Tpetra::Access::ReadWrite).data());
  mesh.for_each_box([&](int l, int b) {
    Index3 const pitch = mesh.box(l, b).strides();
    out[std::size_t(l)].push_back({values[std::size_t(l)] + mesh.offset(l, b), pitch[1], pitch[2]});
  });
  return out;
}

/// f - A phi by the matrices, into the right-hand sides of the cycle, and rounded into the matrix-free one's.
Real CrsBackend::find_residual() {
  CompositeMesh const& mesh = composite_.mesh();
  auto const right_hand_side = &MultigridLevel::right_hand_side;
  std::vector<Real> const unscaled(scale_.size(), 1);
  if (nothing_)
    composite_.residual(*source_, *nothing_, Norm::max, unscaled, blocks(right_hand_side));
  else
    composite_.residual_of_zero(*source_, Norm::max, unscaled, blocks(right_hand_side));
  for (int l = 0; l < mesh.levels(); ++l) copy_in(phi_->level(l), values_[std::size_t(l)].own());
  average_down(values_);
  for (int l = 0; l < mesh.levels(); ++l) multiply(values_, l, -1, cycle_level(l).right_hand_side);

  Magnitude magnitude(problem_.options.norm);
  Blocks<Real> const values = blocks(right_hand_side);
  mesh.for_each_box([&](int l, int b) {
    Block<Real> const& from = values[std::size_t(l)][std::size_t(b)];
    for (int k = 0; k < mesh.box(l, b).extent(2); ++k)
      mesh.write_plane(l, b, k, from.origin + k * from.pitch_z, scale_[std::size_t(l)],
                       residual_[std::size_t(l)][std::size_t(b)],
                       [&](Real const* cells, std::ptrdiff_t count) { magnitude.add(cells, count, mesh.volume(l)); });
  });
  for (int l = 0; l < mesh.levels(); ++l) cycle_level(l).right_hand_side.own().scale(scale_[0]);
  return magnitude.over(mesh.comm());
}

/// Call f(level, value, value) for each cell of a vector of the matrix-free cycle and of one of this cycle.
template <class F>
void CrsBackend::for_each_pair(Blocks<float> const& single, LevelVector MultigridLevel::*vector, F&& f) {
  Blocks<Real> const values = blocks(vector);
  composite_.mesh().for_each_box([&](int l, int b) {
    Block<float> const& there = single[std::size_t(l)][std::size_t(b)];
    Block<Real> const& here = values[std::size_t(l)][std::size_t(b)];
    Box const& box = composite_.mesh().box(l, b);
    for (int k = 0; k < box.extent(2); ++k)
      for (int j = 0; j < box.extent(1); ++j)
        for (int i = 0; i < box.extent(0); ++i)
          f(l, there.origin[i + j * there.pitch_y + k * there.pitch_z],
            here.origin[i + j * here.pitch_y + k * here.pitch_z]);
  });
}

/// A vector of the cycle by what BiCGStab makes of it.
void CrsBackend::replace(LevelVector MultigridLevel::*vector,
                         CompositeVector const& (BiCgStab::*make)(CompositeVector const&)) {
  for (std::size_t l = 0; l < values_.size(); ++l) values_[l].assign((cycle_level(int(l)).*vector));
  CompositeVector const& made = ((*bicgstab_).*make)(values_);
  for (std::size_t l = 0; l < values_.size(); ++l) (cycle_level(int(l)).*vector).assign(made[l]);
}

void CrsBackend::run_cycle() {
  if (in_single_)
    for_each_pair(residual_, &MultigridLevel::right_hand_side,
                  [&](int l, float there, Real& here) { here = scale_[0] / scale_[std::size_t(l)] * Real(there); });
  if (bicgstab_) replace(&MultigridLevel::right_hand_side, &BiCgStab::direction);
  multigrid_.cycle();
  if (bicgstab_) replace(&MultigridLevel::correction, &BiCgStab::step);
  if (in_single_)
    for_each_pair(correction_, &MultigridLevel::correction,
                  [&](int, float& there, Real here) { there = float(here / unit_of_correction()); });
}

}  // namespace

std::unique_ptr<Backend> make_crs_backend(Problem const& problem, Reusable& reusable) {
  return std::make_unique<CrsBackend>(problem, reusable);
}

}  // namespace amrpic
