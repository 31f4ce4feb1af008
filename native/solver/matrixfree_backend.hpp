#pragma once

#include <algorithm>
#include <optional>

#include "matrixfree/composite.hpp"
#include "matrixfree/cycle.hpp"
#include "matrixfree/damping.hpp"
#include "solver/backend.hpp"
#include "solver/compressed_rows.hpp"
#include "solver/minimal_residual.hpp"

namespace amrpic {

/// Stencils evaluated box by box: potential and residual in double precision, corrections in single.
class MatrixFreeBackend : public Backend {
 public:
  /// Collective.
  explicit MatrixFreeBackend(Problem const& problem);

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
  void finish() override {}

  ElectricField electric_field(std::shared_ptr<Field const> potential, CoveredField covered) override;

  ElectricField electric_field_as(Field const& potential, CoveredField covered, Holds holds) override {
    return composite_.electric_field(potential, problem_.walls, covered, holds);
  }
  std::size_t steps_in_turn() const override { return std::min<std::size_t>(steps_.size(), even_steps); }
  std::vector<std::vector<std::vector<FourthOrderField::AddedDensity>>> beside_coarse_faces(
      Field const& density) override {
    if (problem_.options.order == 2) return {};
    return composite_.beside_coarse_faces(density);
  }
  void to_means(Field const& points, Field& means) override { composite_.to_means(points, means); }

  LevelOperators const& operators_with_gradient(int level) override;

  std::int64_t assemblies() const override { return shown_ ? 1 : 0; }
  std::size_t bytes() const override;

 protected:
  // What a solve is made of, on the host here. All are collective.
  virtual Real find_residual();
  virtual void run_cycle() { cycle_.run(); }
  virtual Real add_correction(Real scale) { return composite_.add(correction_, scale, *phi_); }

  Problem problem_;
  CompositeLaplacian composite_;
  matrixfree::Cycle cycle_;
  std::optional<Source> source_;
  std::vector<Real> scale_;  ///< [level]: from a residual to the cycle's
  Blocks<float> residual_, correction_;
  Field* phi_ = nullptr;

 private:
  void relax_behind_gaps();
  void combine_corrections(MinimalResidual::Vectors const& before);
  Real dot(MinimalResidual::Vectors const& a, MinimalResidual::Vectors const& b);
  Blocks<float> blocks(matrixfree::Vector& (matrixfree::SweptLevel::*vector)());
  Real largest(Blocks<float> const& blocks, std::vector<Real> const& scale);
  int levels() const { return problem_.hierarchy->level_count(); }

  static constexpr std::size_t even_steps = 5;

  std::vector<matrixfree::Vector> kept_;  ///< residuals, while the error of the mesh is estimated
  Real largest_source_ = 0;               ///< magnitude of f, V/m^2
  Real unit_ = 1;                         ///< what 1 stands for in the corrections of the cycle, V
  bool accelerated_ = false;
  /// Of each level; empty until first used, and where no rank has any.
  std::vector<std::vector<matrixfree::SweptLevel::PlaceAndDiagonal>> behind_gaps_;
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
