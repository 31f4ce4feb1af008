#pragma once

#include <memory>
#include <vector>

#include "matrixfree/composite_average.hpp"
#include "matrixfree/composite_field.hpp"
#include "matrixfree/composite_residual.hpp"
#include "matrixfree/composite_truncation.hpp"

namespace amrpic {

/// The operator L = Laplace - shift over all levels of a hierarchy at once, in double precision and without matrices:
/// the same formulas as the operators `composite`, `coarse_boundary`, `fine_boundary`, `restriction` and `gradient`,
/// evaluated box by box.
///
/// Each act on the cells is a class of its own. The ghosts around a box are copied from its neighbours or evaluated
/// from walls and coarser cells just before the box is swept; finer levels come first and leave the fluxes through the
/// coarse faces for the coarser ones, so that each face has one flux. Results in a cell do not depend on boxes and
/// ranks, not even by rounding.
class CompositeLaplacian {
 public:
  /// `shift`: of the Equation. `hierarchy` is in coordinates stretched by `stretch` already; norms and fields are those
  /// of the unstretched space. Collective.
  explicit CompositeLaplacian(std::shared_ptr<Hierarchy const> hierarchy, Real shift = 0,
                              Real3 const& stretch = {1, 1, 1})
      : mesh_(std::move(hierarchy), shift, stretch) {}
  CompositeLaplacian(CompositeLaplacian const&) = delete;  // its parts refer to the mesh
  CompositeLaplacian& operator=(CompositeLaplacian const&) = delete;

  /// Set the covered cells of all levels to the mean of their children. Collective.
  void average_down(Field& phi) { average_.average_down(phi); }

  /// phi += scale * correction on all levels, then `average_down`; corrections in covered cells are not used. Returns
  /// the largest magnitude that was added on this rank, those in covered cells included. Collective.
  template <class T>
  Real add(Blocks<T> const& correction, Real scale, Field& phi) {
    return average_.add(correction, scale, phi);
  }

  /// residual = scale[level] * (f - L phi) in uncovered cells, zero in covered ones, rounded to T; returns the
  /// norm, without the scale and before rounding, over uncovered cells; nan if a value is not finite. `phi` must be
  /// averaged down. Collective.
  template <class T>
  Real residual(Source const& source, Field const& phi, Norm norm, std::vector<Real> const& scale,
                Blocks<T> const& residual) {
    return residual_.residual(source, phi, norm, scale, residual);
  }

  /// The same for a potential of zero: f less what the wall data add to the Laplacian. Collective.
  template <class T>
  Real residual_of_zero(Source const& source, Norm norm, std::vector<Real> const& scale, Blocks<T> const& residual) {
    return residual_.residual_of_zero(source, norm, scale, residual);
  }

  /// Norm of f less what the wall data add to the Laplacian. Collective.
  Real right_hand_side_norm(Source const& source, Norm norm) { return residual_.right_hand_side_norm(source, norm); }

  /// Integral over uncovered cells of f less what the wall data add to the Laplacian, and of the magnitudes of all
  /// terms of that, in the stretched space. Collective.
  IntegralOfSource integrate_right_hand_side(Source const& source) {
    return residual_.integrate_right_hand_side(source);
  }

  /// Norm of the largest single term of the Laplacian, the diagonal one: what rounding is relative to. Collective.
  Real diagonal_norm(Field const& phi, Norm norm) { return residual_.diagonal_norm(phi, norm); }

  /// truncation = scale[level] * the truncation error of the Laplacian in uncovered cells, zero in covered ones,
  /// rounded to T: for each cell what the Laplacian of the next coarser level makes of the mean potentials there, less
  /// the mean of f, over three; trilinear between the coarser cells. The base's next coarser level has `base_ratio`
  /// times its spacing; {1, 1, 1} if it has none, which leaves zeros there. Nothing is known of cells at walls, and of
  /// those with covered children. `phi` must be averaged down. Lists are made anew by each call. Returns the largest
  /// magnitude, without the scale. Collective.
  template <class T>
  Real truncation(Source const& source, Field const& phi, Index3 const& base_ratio, std::vector<Real> const& scale,
                  Blocks<T> const& truncation) {
    return composite_truncation(mesh_, source, phi, base_ratio, scale, truncation);
  }

  /// E = -grad phi (V/m; over the stretch along each axis once more), from the fluxes through the faces. `potential`
  /// must be averaged down, and stay as it is. Collective.
  ElectricField electric_field(std::shared_ptr<Field const> potential, std::vector<Walls> const& walls,
                               CoveredField covered) {
    return field_.electric_field(std::move(potential), walls, covered);
  }

  // What this rank sends in a call of `residual`, besides the norm, and of `add`.
  Traffic of_residual() const { return mesh_.plan().of_residual(); }
  Traffic of_add() const { return mesh_.plan().of_average(); }

  Hierarchy const& hierarchy() const { return mesh_.hierarchy(); }
  /// Of lists and buffers on this rank.
  std::size_t bytes() const {
    return mesh_.plan().bytes() + ghosts_.bytes() + average_.bytes() + residual_.bytes() + field_.bytes();
  }

 private:
  CompositeMesh mesh_;
  CompositeGhosts ghosts_{mesh_};
  CompositeAverage average_{mesh_};
  CompositeResidual residual_{mesh_, ghosts_};
  CompositeField field_{mesh_, ghosts_};
};

}  // namespace amrpic
