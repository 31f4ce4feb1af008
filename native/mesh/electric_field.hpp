#pragma once

#include <array>
#include <memory>
#include <utility>
#include <vector>

#include "mesh/boundary_cells.hpp"
#include "mesh/field.hpp"
#include "stencil/field_difference.hpp"

namespace amrpic {

/// What E holds in covered cells.
enum class CoveredField {
  mean,       ///< of the children, as in all fields
  difference  ///< of phi, whose covered cells hold the means: what clouds as wide as these cells feel
};

/// Write a row of cells, their components along x, y, z side by side, past the cache where that can be done:
/// `stream_end` must follow before others read.
void write_cells(std::array<Real const*, 3> const& from, int count, Real* out);

/// What particles feel beside a field on the mesh, to make up for what their clouds smooth: on each level and along
/// each axis, `factor` of a density for `field_between`.
struct Compensation {
  std::shared_ptr<Field const> density;  ///< C/m³; null: nothing
  std::vector<Real3> factor;             ///< of each level
};

/// The electric field on a hierarchy. It is stored in the boundary cells of boxes; inside boxes it is the difference of
/// a potential across a cell, or, where components are given, these.
class ElectricField {
 public:
  /// Of a potential, with factor[level] per axis for `field_between`. The caller sets the boundary cells.
  ElectricField(std::shared_ptr<Field const> potential, std::vector<Real3> factor);

  /// Of components in all cells.
  explicit ElectricField(std::array<std::shared_ptr<Field const>, 3> components);

  Hierarchy const& hierarchy() const { return *hierarchy_; }

  BoundaryCells const& boundary(int level) const { return levels_[std::size_t(level)].boundary; }
  /// The values there, as `write_cells` leaves them.
  Real const* at_boundary(int level) const { return boundary_values_.data() + levels_[std::size_t(level)].first; }
  Real* at_boundary(int level) { return boundary_values_.data() + levels_[std::size_t(level)].first; }
  static constexpr int components_per_cell = 3;

  Field const* potential() const { return potential_.get(); }  ///< null if components are given
  /// Only if they are given.
  Field const& component(int axis) const { return *components_[std::size_t(axis)]; }
  Real3 const& factor(int level) const { return levels_[std::size_t(level)].factor; }

  /// What gather adds to it. The field on the mesh stays what it is.
  Compensation const& compensation() const { return compensation_; }
  void compensate(Compensation compensation) { compensation_ = std::move(compensation); }

  /// Set the boundary cells of plane k of a box, both counted from the first one of this rank; `stream_end` must follow
  /// before they are read.
  void set_boundary(int level, int b, int k, std::array<Real const*, 3> const& plane);

  /// Write plane k of a box.
  void write_plane(int level, int b, int k, std::array<Real*, 3> const& plane) const;

  /// Write the components of some cells of a box, in its level's indices, side by side, x fastest.
  void write_part(int level, int b, Box const& cells, Real* out) const;

  /// Write all cells.
  void write(std::array<Field*, 3> const& components) const;

 private:
  struct OnLevel {
    BoundaryCells boundary;
    std::size_t first;  ///< of its values in `boundary_values_`
    Real3 factor;
  };
  void lay_out_boundary();
  LocalIndex first_cell(int level, int b) const {
    return hierarchy_->level(level).local_offset(hierarchy_->level(level).first_local_box() + b);
  }
  Box const& box(int level, int b) const {
    return hierarchy_->level(level).box(hierarchy_->level(level).first_local_box() + b);
  }
  template <class F>
  void for_each_plane(F&& f) const;

  std::shared_ptr<Hierarchy const> hierarchy_;
  std::shared_ptr<Field const> potential_;
  Compensation compensation_;
  std::array<std::shared_ptr<Field const>, 3> components_;
  std::vector<OnLevel> levels_;
  LargeArray<Real> boundary_values_;  ///< of all levels: one block, so that it is large
};

}  // namespace amrpic
