#pragma once

#include <memory>
#include <vector>

#include "composite/composite_average.hpp"
#include "composite/composite_field.hpp"
#include "composite/composite_residual.hpp"
#include "composite/composite_truncation.hpp"
#include "composite/fourth_order_field.hpp"
#include "composite/fourth_order_residual.hpp"

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
  /// of the unstretched space. `order`: 2, of values at the cells' centres, or 4, of their means. `metal`: in
  /// second order; null if there is none. Collective.
  explicit CompositeLaplacian(std::shared_ptr<Hierarchy const> hierarchy, Real shift = 0,
                              Real3 const& stretch = {1, 1, 1}, int order = 2, Metal const* metal = nullptr)
      : mesh_(std::move(hierarchy), shift, stretch, metal) {
    if (order == 4) {
      means_ = std::make_unique<OnMeans>(mesh_, average_);
      residual_ = std::make_unique<FourthOrderResidual>(mesh_, means_->ghosts);
    } else {
      points_ = std::make_unique<OnPoints>(mesh_);
      residual_ = std::make_unique<SecondOrderResidual>(mesh_, points_->ghosts);
    }
  }
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
    return residual_->residual(source, phi, norm, scale, residual);
  }

  /// The same for a potential of zero: f less what the wall data add to the Laplacian. Collective.
  template <class T>
  Real residual_of_zero(Source const& source, Norm norm, std::vector<Real> const& scale, Blocks<T> const& residual) {
    return residual_->residual_of_zero(source, norm, scale, residual);
  }
  /// Whether that is all that data make of a residual: not where potentials of electrodes are in ghosts.
  bool has_residual_of_zero() const { return !mesh_.has_metal_faces(); }

  /// Norm of f less what the wall data add to the Laplacian. Collective.
  Real right_hand_side_norm(Source const& source, Norm norm) { return residual_->right_hand_side_norm(source, norm); }

  /// Integral over uncovered cells of f less what the wall data add to the Laplacian, and of the magnitudes of all
  /// terms of that, in the stretched space. Collective.
  IntegralOfSource integrate_right_hand_side(Source const& source) {
    return residual_->integrate_right_hand_side(source);
  }

  /// Set phi to the potential of electrodes in their cells, coarse ones to the mean of their children. Collective.
  void fill_metal(std::vector<Real> const& potentials, Field& phi) {
    if (!mesh_.metal()) return;
    mesh_.for_each_box([&](int l, int b) {
      Real* plane = phi.level(l).data() + mesh_.offset(l, b);
      for (int k = 0; k < mesh_.box(l, b).extent(2); ++k, plane += mesh_.box(l, b).stride(2))
        mesh_.for_each_in_metal(
            l, b, k, Covered::visit, [](CompositeMesh::CutHere const&) {},
            [&](std::ptrdiff_t at, int n, int electrode) {
              std::fill_n(plane + at, n, potentials[std::size_t(electrode)]);
            });
    });
    average_down(phi);
  }
  /// Call f(electrode, charge in C) for what a density holds in the uncovered cells of metal on this rank. Local.
  template <class F>
  void for_each_charge_within(Field const& rho, F&& f) {
    mesh_.for_each_box([&](int l, int b) {
      Box const& own = mesh_.box(l, b);
      Real const* plane = rho.level(l).data() + mesh_.offset(l, b);
      for (int k = 0; k < own.extent(2); ++k, plane += own.stride(2))
        mesh_.for_each_in_metal(
            l, b, k, Covered::skip, [](CompositeMesh::CutHere const&) {},
            [&](std::ptrdiff_t at, int n, int electrode) {
              for (Real const* density = plane + at; density != plane + at + n; ++density)
                f(electrode, mesh_.volume(l) * *density);
            });
    });
  }
  /// Call f(electrode, weight) for what uncovered cells on this rank see of metal: arms that end on it, with the weight
  /// of its potential over the diagonal, and at no weight cells in it and shares of faces. Local.
  template <class F>
  void for_each_sight(F&& f) {
    mesh_.for_each_box([&](int l, int b) {
      Box const& own = mesh_.box(l, b);
      for (int k = 0; k < own.extent(2); ++k)
        mesh_.for_each_in_metal(
            l, b, k, Covered::skip,
            [&](CompositeMesh::CutHere const& here) {
              for (std::size_t n = 0; n < 6; ++n)
                if (here.cell.is_cut(n)) f(here.cell.electrode[n], here.row.surface(n) / here.row.diagonal);
            },
            [&](std::ptrdiff_t, int, int electrode) { f(electrode, 0); });
      for (SharedFace const& face : mesh_.shared_faces(l))
        if (own.contains(face.cell) && !mesh_.is_covered(l, b, face.cell)) f(face.electrode, 0);
    });
  }
  /// See CompositeResidual. Collective.
  void for_each_charge(Source const& source, Field const& phi, CompositeResidual::OfCharge const& f) {
    residual_->for_each_charge(source, phi, f);
  }

  /// Norm of the largest single term of the Laplacian, the diagonal one: what rounding is relative to. Collective.
  Real diagonal_norm(Field const& phi, Norm norm) { return residual_->diagonal_norm(phi, norm); }

  /// truncation = scale[level] * the truncation error of the Laplacian in uncovered cells, zero in covered ones:
  /// for each cell what the Laplacian of the next coarser level makes of the mean potentials there, less
  /// the mean of f, over three; trilinear between the coarser cells. The base's next coarser level has `base_ratio`
  /// times its spacing; {1, 1, 1} if it has none, which leaves zeros there. Nothing is known of cells at walls, and of
  /// those with covered children. `phi` must be averaged down. Lists are made anew by each call. Returns the largest
  /// magnitude, without the scale. Collective.
  /// In fourth order it comes from sixth differences, on all levels, and needs nothing coarser.
  Real truncation(Source const& source, Field const& phi, Index3 const& base_ratio, std::vector<Real> const& scale,
                  Blocks<float> const& truncation) {
    if (means_) return means_->field.truncation(phi, source.walls, scale, truncation);
    return composite_truncation(mesh_, source, phi, base_ratio, scale, truncation);
  }

  /// E = -grad phi (V/m; over the stretch along each axis once more), from the fluxes through the faces. `potential`
  /// must be averaged down, and stay as it is. Collective.
  ElectricField electric_field(std::shared_ptr<Field const> potential, std::vector<Walls> const& walls,
                               CoveredField covered, std::vector<Real> const& potentials = {}) {
    if (mesh_.metal()) return points_->field.beside_metal(*potential, walls, potentials, covered, average_);
    if (means_) return means_->field.electric_field(*potential, walls, covered, Holds::points);
    return points_->field.electric_field(std::move(potential), walls, covered);
  }

  // ---- in fourth order alone ----

  bool is_of_means() const { return means_ != nullptr; }

  /// E as `electric_field`, its means or its values at the centres. Collective.
  ElectricField electric_field(Field const& potential, std::vector<Walls> const& walls, CoveredField covered,
                               Holds holds) {
    return means_->field.electric_field(potential, walls, covered, holds);
  }
  /// See FourthOrderField. Collective.
  auto beside_coarse_faces(Field const& density) { return means_->field.beside_coarse_faces(density); }
  void to_means(Field const& points, Field& means) { means_->field.to_means(points, means); }

  Hierarchy const& hierarchy() const { return mesh_.hierarchy(); }
  CompositeMesh& mesh() { return mesh_; }  ///< in whose lists others may do the same
  /// Of lists and buffers on this rank.
  std::size_t bytes() const {
    std::size_t const of_order = means_ ? means_->ghosts.bytes() : points_->ghosts.bytes() + points_->field.bytes();
    return mesh_.plan().bytes() + mesh_.transfer().bytes() + average_.bytes() + residual_->bytes() + of_order;
  }

 private:
  struct OnPoints {
    explicit OnPoints(CompositeMesh& mesh) : ghosts(mesh), field(mesh, ghosts) {}
    CompositeGhosts ghosts;
    CompositeField field;
  };
  struct OnMeans {
    OnMeans(CompositeMesh& mesh, CompositeAverage& average) : ghosts(mesh), field(mesh, ghosts, average) {}
    FourthOrderGhosts ghosts;
    FourthOrderField field;
  };
  CompositeMesh mesh_;
  CompositeAverage average_{mesh_};
  std::unique_ptr<OnPoints> points_;  ///< in second order
  std::unique_ptr<OnMeans> means_;    ///< in fourth order
  std::unique_ptr<CompositeResidual> residual_;
};

}  // namespace amrpic
