#pragma once

#include <functional>

#include "mesh/transfer.hpp"
#include "solver/backend.hpp"
#include "solver/krylov.hpp"
#include "solver/multigrid.hpp"
#include "solver/reusable.hpp"

namespace amrpic {

/// The eight operators of each level as compressed rows, with the solver's whole menu.
class CrsBackend : public Backend {
 public:
  /// `reusable`: of a solver of the same options, or empty; becomes what is in use. Collective.
  CrsBackend(Problem const& problem, Reusable& reusable);
  CrsBackend(CrsBackend const&) = delete;  // the cycle refers to the operators
  CrsBackend& operator=(CrsBackend const&) = delete;

  void set_right_hand_side(Field const& rho) override;
  Integral integrate_right_hand_side() override;
  void take_away(Background const& background) override;
  Real largest_right_hand_side() override;
  Real right_hand_side_norm() override;

  void start(Field& phi, bool is_zero) override;
  Real residual() override;
  void improve() override;
  void accelerate() override;
  Real largest_correction() override;
  Real largest_phi_term() override;
  Real discretisation_error() override;
  void finish() override;

  ElectricField electric_field(std::shared_ptr<Field const> potential, CoveredField covered) override;

  LevelOperators const& operators(int level) const { return *operators_[multigrid_levels_.base + std::size_t(level)]; }
  LevelOperators const& operators_with_gradient(int level) override;

  std::int64_t assemblies() const override { return assemblies_; }
  std::int64_t bottom_setups() const override { return bottom_setups_; }
  std::int64_t levels_assembled() const override { return levels_assembled_; }
  std::size_t bytes() const override;

 private:
  MultigridLevel& cycle_level(int l) { return multigrid_.level(multigrid_levels_.base + std::size_t(l)); }
  Equation equation(int l) const { return multigrid_levels_.equation(multigrid_levels_.base + std::size_t(l)); }
  Real norm(Norm norm, std::function<LevelVector const&(int)> const& vector_of) const;
  MultigridOperators assembled(Reusable& reusable);
  std::shared_ptr<Bottom> bottom(Reusable& reusable);
  CompositeVector zero() const;
  void average_down(CompositeVector& x) const;
  void multiply(CompositeVector const& x, int l, Real scale, LevelVector& out) const;
  void compute_residual();
  CompositeEquations equations();
  void find_cells_behind_gaps();
  void relax_behind_gaps(CompositeVector const& residual, CompositeVector& correction) const;
  void set_truncation();
  void difference_covered(std::array<Field*, 3> const& components);

  Problem problem_;
  std::shared_ptr<Hierarchy const> hierarchy_;
  SolverOptions const& options_;
  MultigridLevels multigrid_levels_;
  std::int64_t levels_assembled_ = 0;
  MultigridOperators operators_;
  Transfer transfer_;
  std::int64_t bottom_setups_ = 0;
  Multigrid multigrid_;
  std::unique_ptr<Krylov> krylov_;  ///< null if nothing is to be accelerated
  /// Rows of each level; empty until cycles are accelerated, and where no rank has any.
  std::vector<UntilFinalize<DeviceArray<LocalIndex>>> behind_gaps_;
  bool knows_gaps_ = false;
  CompositeVector phi_;
  CompositeVector right_hand_side_;  ///< f = -rho / eps0 - background minus what walls add; 0 in covered cells
  Field const* rho_ = nullptr;
  Background background_;
  Real unit_ = 1;  ///< what 1 stands for in all vectors of a solve, V and V/m^2; a power of two, so exact
  Field* result_ = nullptr;
  bool has_gradient_ = false;
  std::vector<std::array<SparseMatrix, 3>>
      covered_gradient_;  ///< of each level below the finest; empty until first used
  std::int64_t assemblies_ = 1;
};

}  // namespace amrpic
