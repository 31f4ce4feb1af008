#pragma once

#include <memory>
#include <string>
#include <vector>

#include "base/constants.hpp"
#include "freespace/free_space.hpp"
#include "mesh/field.hpp"
#include "mesh/transfer.hpp"
#include "operators/walls.hpp"
#include "solver/krylov.hpp"
#include "solver/multigrid.hpp"

namespace amrpic {

/// How a solve went.
struct SolveReport {
  bool converged = false;
  int cycles = 0;
  std::vector<Real> residuals;    ///< before the first cycle and after each, relative to the right-hand side
  Real discretisation_error = 0;  ///< estimate of the largest error of phi that the mesh makes, V; 0: not asked for
  Real floor = 0;                 ///< estimate of the relative residual that rounding alone leaves
  std::string reason;
  std::map<std::string, Real> seconds;
};

/// What a solver can hand on to that of another hierarchy on the same domain: the operators of levels that stay with
/// their neighbours, the bottom, if its matrix is the same, and the tables of free space.
struct Reusable {
  std::shared_ptr<Assembled> operators;  ///< emptied by the first solver that takes them
  std::shared_ptr<Bottom> bottom;
  std::shared_ptr<freespace::FreeSpace> free_space;
};

/// Solves Laplace phi = -rho / eps0 over all levels of a hierarchy at once. Set up once per hierarchy, solved many
/// times. With options.stretch = s the Laplacian is the sum of (1/s_d^2) d^2/dx_d^2: that of coordinates s_d x_d, in
/// which everything below lives.
class PoissonSolver {
 public:
  /// `reusable`, if any, comes from a solver of the same options. Collective.
  PoissonSolver(std::shared_ptr<Hierarchy const> hierarchy, SolverOptions const& options, Reusable const& reusable);
  PoissonSolver(PoissonSolver const&) = delete;  // the cycle refers to the operators
  PoissonSolver& operator=(PoissonSolver const&) = delete;

  /// The wall faces of a level on this rank; their Dirichlet and Neumann data may be set before a solve.
  Walls& walls(int level) { return walls_[level]; }

  /// Fill phi (V) from rho (C/m^3), starting from what phi holds. Covered cells of phi hold the mean of their children.
  /// Throws SolverError for a charge that no potential can balance. Collective.
  SolveReport solve(Field const& rho, Field& phi);

  /// Fill the three components of E, -(1/s_d^2) d phi/dx_d (V/m); walls count with the data of the latest solve.
  /// Collective.
  void electric_field(Field const& phi, std::vector<Field*> const& components, CoveredField covered);

  Hierarchy const& hierarchy() const { return *given_; }
  LevelOperators const& operators(int level) const { return *operators_[stack_.base + level]; }
  LevelOperators const& operators_with_gradient(int level);

  Reusable const& reusable() const { return reusable_; }
  std::int64_t assemblies() const { return assemblies_; }              ///< operator assemblies so far
  std::int64_t levels_assembled() const { return levels_assembled_; }  ///< of the stack; the others were handed on
  std::int64_t bottom_setups() const { return bottom_setups_; }        ///< 0 if the bottom was handed on, else 1
  std::int64_t messages() const { return halo_sum(&Exchange::messages) - messages_before_; }  ///< sent by this rank
  std::int64_t message_bytes() const { return halo_sum(&Exchange::bytes) - bytes_before_; }
  std::size_t operator_bytes() const;  ///< of this rank's CRS storage

 private:
  MultigridLevel& cycle_level(int l) { return multigrid_.level(stack_.base + std::size_t(l)); }
  /// Call f(row) for each cell of a level that no finer level covers.
  template <class F>
  void for_each_uncovered(int l, F&& f) const {
    LevelOperators const& o = operators(l);
    for (LocalIndex row = 0; row < o.rows(); ++row)
      if (o.uncovered[row]) f(row);
  }
  template <class Value>
  Real norm(Value&& value) const;
  Real composite_integral(bool magnitude) const;
  Real largest_phi_term() const;

  StackOperators assembled();
  std::shared_ptr<Bottom> bottom();
  std::int64_t halo_sum(std::int64_t (Exchange::*of)() const) const;
  void set_open_walls(Field const& rho);
  void set_right_hand_side(Field const& rho);
  void remove_net_charge();
  Composite zero() const;
  void average_down(Composite& x) const;
  template <class F>
  void subtract(int l, F&& f, Composite const& x, std::vector<Real>& out) const;
  void compute_residual();
  Real residual_norm();
  void improve(Krylov* krylov);
  CompositeEquations equations();
  void fix_constant();
  void iterate(SolveReport& report);
  bool below_discretisation(SolveReport& report);
  Real discretisation_error();
  void set_truncation();
  Real largest_correction();
  Real largest_uncovered(std::vector<Real> const& (*values)(MultigridLevel&));
  void difference_covered(std::vector<Field*> const& components);

  std::shared_ptr<Hierarchy const> given_;
  std::shared_ptr<Hierarchy const> hierarchy_;  ///< the given one in stretched coordinates
  SolverOptions options_;
  LevelStack stack_;
  Reusable reusable_;
  std::int64_t levels_assembled_ = 0;
  StackOperators operators_;
  std::int64_t messages_before_, bytes_before_;  ///< by operators that were handed on
  Transfer transfer_;
  std::int64_t bottom_setups_ = 0;
  Multigrid multigrid_;
  Composite phi_;              ///< own cells and ghosts
  Composite right_hand_side_;  ///< f = -rho / eps0 minus what walls add
  std::vector<Walls> walls_;
  Stopwatch stopwatch_;
  Real latest_correction_ = 0, correction_before_ = 0;  ///< largest change of phi by the latest two cycles, V
  bool has_gradient_ = false;
  std::vector<std::array<Crs, 3>> covered_gradient_;  ///< of each level below the finest; empty until asked for
  std::int64_t assemblies_ = 1;
};

}  // namespace amrpic
