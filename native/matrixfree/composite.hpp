#pragma once

#include <algorithm>
#include <array>
#include <functional>
#include <memory>
#include <vector>

#include "matrixfree/composite_kernels.hpp"
#include "matrixfree/composite_plan.hpp"
#include "mesh/array_on_box.hpp"
#include "mesh/electric_field.hpp"
#include "mesh/field.hpp"
#include "mesh/norm.hpp"
#include "operators/operators.hpp"
#include "operators/walls.hpp"

namespace amrpic {

/// Values of a box somewhere in memory: x fastest, rows and planes at their own distances.
template <class T>
struct Block {
  T* origin;
  std::ptrdiff_t pitch_y, pitch_z;
};

/// Blocks of the boxes of this rank: [level][local box].
template <class T>
using Blocks = std::vector<std::vector<Block<T>>>;

/// Distances in memory of the neighbours of a cell of a box.
inline Index3 pitches(Box const& box) { return {1, box.extent(0), box.extent(0) * box.extent(1)}; }

/// What the right-hand side f = -rho / eps0 - background is made of, with the data of the walls of each level.
struct Source {
  Field const& rho;  ///< C/m^3; values in covered cells are not used
  std::vector<Walls> const& walls;
  Background background{};
};

/// The operator L = Laplace - shift over all levels of a hierarchy at once, in double precision and without matrices:
/// the same formulas as the operators `composite`, `coarse_boundary`, `fine_boundary`, `restriction` and `gradient`,
/// evaluated box by box.
///
/// The ghosts around a box are copied from its neighbours or evaluated from walls and coarser cells just before the box
/// is swept; finer levels come first and leave the fluxes through the coarse faces for the coarser ones, so that each
/// face has one flux. Results in a cell do not depend on boxes and ranks, not even by rounding.
class CompositeLaplacian {
 public:
  /// `shift`: of the Equation. `hierarchy` is in coordinates stretched by `stretch` already; norms and fields are those
  /// of the unstretched space. Collective.
  explicit CompositeLaplacian(std::shared_ptr<Hierarchy const> hierarchy, Real shift = 0,
                              Real3 const& stretch = {1, 1, 1});

  /// Set the covered cells of all levels to the mean of their children. Collective.
  void average_down(Field& phi);

  /// phi += scale * correction on all levels, then `average_down`; corrections in covered cells are not used. Returns
  /// the largest magnitude that was added on this rank, those in covered cells included. Collective.
  template <class T>
  Real add(Blocks<T> const& correction, Real scale, Field& phi);

  /// residual = scale[level] * (f - L phi) in uncovered cells, zero in covered ones, rounded to T; returns the
  /// norm, without the scale and before rounding, over uncovered cells; nan if a value is not finite. `phi` must be
  /// averaged down. Collective.
  template <class T>
  Real residual(Source const& source, Field const& phi, Norm norm, std::vector<Real> const& scale,
                Blocks<T> const& residual);

  /// The same for a potential of zero: f less what the wall data add to the Laplacian. Collective.
  template <class T>
  Real residual_of_zero(Source const& source, Norm norm, std::vector<Real> const& scale, Blocks<T> const& residual);

  /// Norm of f less what the wall data add to the Laplacian. Collective.
  Real right_hand_side_norm(Source const& source, Norm norm);

  /// Integral over uncovered cells of f less what the wall data add to the Laplacian, and of the magnitudes of all
  /// terms of that, in the stretched space. Collective.
  struct Integrals {
    Real net, magnitude;
  };
  Integrals integrate_right_hand_side(Source const& source);

  /// Norm of the largest single term of the Laplacian, the diagonal one: what rounding is relative to. Collective.
  Real diagonal_norm(Field const& phi, Norm norm);

  /// truncation = scale[level] * the truncation error of the Laplacian in uncovered cells, zero in covered ones,
  /// rounded to T: for each cell what the Laplacian of the next coarser level makes of the mean potentials there, less
  /// the mean of f, over three; trilinear between the coarser cells. The base's next coarser level has `base_ratio`
  /// times its spacing; {1, 1, 1} if it has none, which leaves zeros there. Nothing is known of cells at walls, and of
  /// those with covered children. `phi` must be averaged down. Lists are made anew by each call. Returns the largest
  /// magnitude, without the scale. Collective.
  template <class T>
  Real truncation(Source const& source, Field const& phi, Index3 const& base_ratio, std::vector<Real> const& scale,
                  Blocks<T> const& truncation);

  /// E = -grad phi (V/m; over the stretch along each axis once more), from the fluxes through the faces. `potential`
  /// must be averaged down, and stay as it is. Collective.
  ElectricField electric_field(std::shared_ptr<Field const> potential, std::vector<Walls> const& walls,
                               CoveredField covered);

  Hierarchy const& hierarchy() const { return *hierarchy_; }
  std::int64_t messages() const;       ///< sent by this rank so far
  std::int64_t message_bytes() const;  ///< sent by this rank so far
  std::size_t bytes() const;           ///< of lists and buffers on this rank

 private:
  enum class Hidden { visit, skip };
  enum class Where { everywhere, at_faces };

  void visit(Field const& phi, std::vector<Walls> const& walls, Hidden hidden, std::function<void(int, int)> const& f,
             std::function<void(int)> const& done = nullptr);
  void surround(int l, int b, Field const& phi, Walls const& walls);
  void fill_wall(int l, int b, int axis, int side, Real const* phi, Real const* data);
  void fill_interface(int l, int b, int axis, int side, Field const& phi);
  void copy(Rectangle const& from, Real const* own, Real* to, std::ptrdiff_t pitch) const;
  void send_fluxes(int l);

  void residual_plane(int l, int b, int k, Source const& source, Field const& phi);
  void right_hand_side_plane(int l, int b, int k, Source const& source);
  void term_sizes_plane(int l, int b, int k, Source const& source);
  template <class F>
  void for_each_wall_term(int l, int b, int k, Source const& source, F&& f) const;
  void diagonal_plane(int l, int b, int k, Field const& phi);
  template <class T>
  void prolong_truncation(int l, int b, Index3 const& ratio, Window<Real> const& error, Real scale, Block<T> const& out,
                          Magnitude& largest);
  /// Round scale times `plane_` into plane k of a block; zeros if the scale is zero.
  template <class T>
  void write_plane(int l, int b, int k, Real scale, Block<T> const& out) const {
    int const nx = box(l, b).extent(0);
    for (int j = 0; j < box(l, b).extent(1); ++j) {
      Real const* __restrict from = plane_.data() + std::ptrdiff_t(j) * nx;
      T* __restrict to = out.origin + j * out.pitch_y + k * out.pitch_z;
      fetch<Use::write>(to + out.pitch_z, nx);  // rows of a box lie far apart in vectors of the cycle
      if (scale == 0)
        std::fill_n(to, nx, T(0));
      else
        for (int i = 0; i < nx; ++i) to[i] = T(scale * from[i]);
    }
  }
  Real* pack_cells(Field const& field, Piece const& piece, Real* out) const;
  template <class F>
  void for_each_covered_row(int l, int b, int k, F&& f) const;
  void clear_covered(int l, int b, int k, Real* plane) const;
  template <class F>
  void for_each_refined(int l, int b, int k, Real const* phi, F&& f) const;
  template <class T>
  void clear_hidden(Blocks<T> const& blocks);
  template <class F>
  void for_each_box(F&& f);
  template <class Fill, class Use>
  void for_each_plane(Fill&& fill, Use&& use);

  template <class Set>
  void set_uncovered(int l, int b, int k, Real* plane, Set&& set);
  void field_plane(int l, int b, int k, Where where, Field const& phi, std::array<Real*, 3> const& e);
  template <class T>
  void add_plane(int l, int b, int k, Block<T> const& correction, Real scale, Real* phi, Largest<T>& largest);
  void average_pair(int l, int b, int k, Field& phi) const;
  void average_across_ranks(int l, Field& phi);
  void average_field(int l, int b, int k, Real* means);
  void give_means(int l, Real const* means, ElectricField& field);
  Real factor_of_field(int l, int axis) const { return field_factor(level(l).spacing()[axis]) / stretch_[axis]; }

  Level const& level(int l) const { return hierarchy_->level(l); }
  LevelPlan const& plan(int l) const { return plan_.levels[std::size_t(l)]; }
  BoxPlan const& plan(int l, int b) const { return plan(l).boxes[std::size_t(b)]; }
  int boxes(int l) const { return level(l).last_local_box() - level(l).first_local_box(); }
  Box const& box(int l, int b) const { return level(l).box(level(l).first_local_box() + b); }
  LocalIndex offset(int l, int b) const { return level(l).local_offset(level(l).first_local_box() + b); }
  Real volume(int l) const;
  Equation equation(int l) const { return equation_on(level(l).spacing(), shift_); }

  std::shared_ptr<Hierarchy const> hierarchy_;
  Real shift_;
  Real3 stretch_;
  CompositePlan plan_;
  std::vector<std::vector<Real>> fluxes_;    ///< [level]: through its coarse faces, see fill_interface
  std::array<std::vector<Real>, 6> beyond_;  ///< ghosts of the box under way, by face, u fastest
  std::vector<Real> coarse_,
      fits_;                 ///< of the interface under way: coarse values, two rows of phi*; else rows of means
  std::vector<Real> plane_;  ///< of the plane under way, or of a pair of them with three components
};

}  // namespace amrpic
