#pragma once

#include <array>
#include <memory>
#include <vector>

#include "base/error.hpp"
#include "matrixfree/fourth_order_field.hpp"
#include "mesh/electric_field.hpp"
#include "mesh/field.hpp"
#include "operators/walls.hpp"
#include "solver/options.hpp"
#include "solver/stopwatch.hpp"
#include "stencil/background.hpp"

namespace amrpic {

struct LevelOperators;

/// An integral over all uncovered cells, and that of the magnitudes of its terms, before they cancel.
struct Integral {
  Real net, magnitude;
};

/// One execution of the equations f - L phi = 0 (see Equation) over all levels at once, and of the cycle that improves
/// phi. All calls are collective; norms are those of the options, over uncovered cells.
class Backend {
 public:
  virtual ~Backend() = default;

  /// Make f of a charge density (C/m^3), which is kept as long as the solve lasts, and of the walls' data.
  virtual void set_right_hand_side(Field const& rho) = 0;
  virtual Integral integrate_right_hand_side() = 0;
  virtual void take_away(Background const& background) = 0;  ///< from f, in place of what was taken away before
  /// Largest magnitude of f, which is to be known before its norm, and before `start`.
  virtual Real largest_right_hand_side() = 0;
  virtual Real right_hand_side_norm() = 0;

  /// Take phi, whose values are the first guess (V), to be improved until `finish`; `is_zero`: nothing but zeros.
  virtual void start(Field& phi, bool is_zero) = 0;
  /// The norm of the residual, which the next cycle will reduce.
  virtual Real residual() = 0;
  virtual void improve() = 0;
  /// From now on, until `start`, let corrections be combined for the least residual: cycles by themselves are slow.
  virtual void accelerate() = 0;
  virtual Real largest_correction() = 0;  ///< change of phi by the latest cycle, V
  /// Norm of the largest single term in the residual: what rounding is relative to.
  virtual Real largest_phi_term() = 0;
  /// Estimate of the largest error of phi that the mesh makes, V; 0 if it cannot be estimated, or not yet.
  virtual Real discretisation_error() = 0;
  /// Leave in phi what was found, means of the children in covered cells.
  virtual void finish() = 0;

  /// E, -(1/s_d^2) d phi/dx_d (V/m); the potential must stay as it is.
  virtual ElectricField electric_field(std::shared_ptr<Field const> potential, CoveredField covered) = 0;

  /// The period of the step lengths, in cycles. Only a whole period reduces all error components equally.
  virtual std::size_t steps_in_turn() const { return 1; }

  /// What wall potentials take beside the charge of cells, see FourthOrderField; nothing in second order.
  virtual std::vector<std::vector<std::vector<FourthOrderField::AddedDensity>>> beside_coarse_faces(Field const&) {
    return {};
  }

  // In fourth order alone: E, points and means, see FourthOrderField.
  virtual ElectricField electric_field_as(Field const&, CoveredField, Holds) { throw SolverError(of_fourth_order); }
  virtual void to_means(Field const&, Field&) { throw SolverError(of_fourth_order); }

  /// The operators of a level as compressed rows, those of E among them; assembled now if the backend has none.
  virtual LevelOperators const& operators_with_gradient(int level) = 0;

  virtual std::int64_t assemblies() const = 0;                 ///< of operators, so far
  virtual std::int64_t levels_assembled() const { return 0; }  ///< the others were taken over
  virtual std::int64_t bottom_setups() const { return 0; }     ///< 1 if the bottom was set up here and not taken over
  virtual std::size_t bytes() const = 0;                       ///< of this rank's operators, lists and vectors

  Stopwatch& stopwatch() { return stopwatch_; }

 protected:
  static constexpr char const* of_fourth_order = "means of cells are what a solver of order 4 knows; set order to 4";
  Stopwatch stopwatch_;
};

/// The equations that a backend executes.
struct Problem {
  std::shared_ptr<Hierarchy const> given;
  std::shared_ptr<Hierarchy const> hierarchy;  ///< the given one in stretched coordinates
  SolverOptions const& options;
  std::vector<Walls> const& walls;  ///< of each level, with their data
};

}  // namespace amrpic
