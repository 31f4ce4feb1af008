#pragma once

#include <algorithm>
#include <memory>
#include <optional>
#include <vector>

#include "base/error.hpp"
#include "composite/composite.hpp"
#include "cycle/cycle.hpp"
#include "solver/compressed_rows.hpp"
#include "solver/damping.hpp"
#include "solver/minimal_residual.hpp"
#include "solver/options.hpp"
#include "solver/stopwatch.hpp"

namespace amrpic {

/// The equations that a backend executes.
struct Problem {
  std::shared_ptr<Hierarchy const> hierarchy;  ///< in stretched coordinates
  SolverOptions const& options;
  std::vector<Walls> const& walls;               ///< of each level, with their data
  std::shared_ptr<Metal const> metal = nullptr;  ///< null if there are no electrodes
  std::vector<Real> const& potentials;           ///< of these, V
};

/// One execution of the equations f - L phi = 0 (see Equation) over all levels at once, and of the cycle that improves
/// phi: stencils evaluated box by box, potential and residual in double precision, corrections in single. Others
/// execute residual, cycle and correction in their own way.
///
/// All calls are collective; norms are those of the options, over uncovered cells.
class Backend {
 public:
  explicit Backend(Problem const& problem);
  virtual ~Backend() = default;
  Backend(Backend const&) = delete;  // its parts refer to each other
  Backend& operator=(Backend const&) = delete;

  /// Make f of a charge density (C/m^3), which is kept as long as the solve lasts, and of the walls' data.
  void set_right_hand_side(Field const& rho) { source_.emplace(Source{rho, problem_.walls, {}, problem_.potentials}); }
  IntegralOfSource integrate_right_hand_side() { return composite_.integrate_right_hand_side(*source_); }
  /// From f, in place of what was taken away before.
  void take_away(Background const& background) { source_->background = background; }
  /// Largest magnitude of f, which is to be known before its norm, and before `start`.
  Real largest_right_hand_side();
  Real right_hand_side_norm();

  /// Take phi, whose values are the first guess (V), to be improved until `finish`; `is_zero`: nothing but zeros.
  virtual void start(Field& phi, bool is_zero);
  /// Give a potential a mean over the domain, also in the midst of a solve.
  virtual void set_mean(Field& phi, Real mean) const;
  /// The norm of the residual, which the next cycle will reduce.
  Real residual();
  void improve();
  /// From now on, until `start`, let corrections be combined for the least residual: cycles by themselves are slow.
  virtual void accelerate();
  Real largest_correction();  ///< change of phi by the latest cycle, V
  /// Norm of the largest single term in the residual: what rounding is relative to.
  virtual Real largest_phi_term() { return composite_.diagonal_norm(*phi_, problem_.options.norm); }
  /// Estimate of the largest error of phi that the mesh makes, V; 0 if it cannot be estimated, or not yet.
  virtual Real discretisation_error();
  /// Say that data of walls were changed since `start`.
  virtual void walls_changed() {}
  /// Leave in phi what was found, means of the children in covered cells.
  virtual void finish() { composite_.fill_metal(problem_.potentials, *phi_); }
  /// See CompositeResidual, for a potential that is averaged down.
  virtual void for_each_charge(Field const& phi, Field const& rho, CompositeResidual::OfCharge const& f) {
    composite_.for_each_charge({rho, problem_.walls, {}, problem_.potentials}, phi, f);
  }

  /// E, -(1/s_d^2) d phi/dx_d (V/m); the potential must stay as it is.
  ElectricField electric_field(std::shared_ptr<Field const> potential, CoveredField covered) {
    return composite_.electric_field(std::move(potential), problem_.walls, covered, problem_.potentials);
  }

  /// Call f(electrode, charge in C) for what a density holds in the uncovered cells of metal on this rank. Local.
  template <class F>
  void for_each_charge_within(Field const& rho, F&& f) {
    composite_.for_each_charge_within(rho, f);
  }

  /// See CompositeLaplacian. Local.
  template <class F>
  void for_each_sight(F&& f) {
    composite_.for_each_sight(f);
  }

  /// The period of the step lengths, in cycles. Only a whole period reduces all error components equally.
  std::size_t steps_in_turn() const { return std::min<std::size_t>(steps_.size(), even_steps); }

  /// What wall potentials take beside the charge of cells, see FourthOrderField; nothing in second order.
  std::vector<std::vector<std::vector<FourthOrderField::AddedDensity>>> beside_coarse_faces(Field const& density) {
    if (problem_.options.order == 2) return {};
    return composite_.beside_coarse_faces(density);
  }

  // In fourth order alone: E, points and means, see FourthOrderField.
  ElectricField electric_field_as(Field const& potential, CoveredField covered, Holds holds) {
    return composite_.electric_field(potential, problem_.walls, covered, holds);
  }
  void to_means(Field const& points, Field& means) { composite_.to_means(points, means); }

  /// The operators of a level as compressed rows, those of E among them; assembled now if the backend has none.
  virtual LevelOperators const& operators_with_gradient(int level);

  virtual std::int64_t assemblies() const { return shown_ ? 1 : 0; }  ///< of operators, so far
  virtual std::int64_t levels_assembled() const { return 0; }         ///< the others were taken over
  virtual std::int64_t bottom_setups() const { return 0; }  ///< 1 if the bottom was set up here and not taken over
  virtual std::size_t bytes() const;                        ///< of this rank's operators, lists and vectors

  Stopwatch& stopwatch() { return stopwatch_; }

 protected:
  // What a solve is made of, box by box here. All are collective.
  virtual Real find_residual();
  virtual void run_cycle() { cycle_.run(); }
  virtual Real add_correction(Real scale) { return composite_.add(correction_, scale, *phi_); }

  Problem problem_;
  CompositeLaplacian composite_;
  cycle::Cycle cycle_;
  std::optional<Source> source_;
  std::vector<Real> scale_;              ///< [level]: from a residual to the cycle's
  Blocks<float> residual_, correction_;  ///< of the cycle
  Field* phi_ = nullptr;

 private:
  void relax_behind_gaps();
  void combine_corrections(MinimalResidual::Vectors const& before);
  Real dot(MinimalResidual::Vectors const& a, MinimalResidual::Vectors const& b);
  Blocks<float> blocks(cycle::Vector& (cycle::SweptLevel::*vector)());
  Real largest(Blocks<float> const& blocks, std::vector<Real> const& scale);
  int levels() const { return problem_.hierarchy->level_count(); }

  static constexpr std::size_t even_steps = 5;

  Stopwatch stopwatch_;
  std::vector<cycle::Vector> kept_;  ///< residuals, while the error of the mesh is estimated
  Real largest_source_ = 0;          ///< magnitude of f, V/m^2
  Real unit_ = 1;                    ///< what 1 stands for in the corrections of the cycle, V
  bool accelerated_ = false;
  /// Of each level; empty until first used, and where no rank has any.
  std::vector<std::vector<cycle::SweptLevel::PlaceAndDiagonal>> behind_gaps_;
  bool knows_gaps_ = false;
  std::optional<Damping> damping_;  ///< in fourth order
  std::vector<Real> steps_;         ///< factors of corrections, in turn
  std::size_t cycles_ = 0;          ///< since `start`
  MinimalResidual corrections_;
  Real latest_residual_ = 0;    ///< its norm, V/m^2
  Real latest_correction_ = 0;  ///< the largest on this rank, V
  bool phi_is_zero_ = false;
  std::shared_ptr<Assembled const> shown_;  ///< null until first used
};

}  // namespace amrpic
