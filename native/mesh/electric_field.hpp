#pragma once

#include <array>
#include <memory>
#include <vector>

#include "mesh/field.hpp"
#include "mesh/rim.hpp"
#include "stencil/field_difference.hpp"

namespace amrpic {

/// Write a row of cells, their components along x, y, z side by side, past the cache where that can be done:
/// `stream_end` must follow before others read.
void write_cells(std::array<Real const*, 3> const& from, int count, Real* out);

/// The electric field on a hierarchy. In the rims of boxes it is kept; inside boxes it is the difference of a potential
/// across a cell, or, where someone gives its components, these.
class ElectricField {
 public:
  /// Of a potential, with factor[level] per axis for `field_between`. The rims are to be set by the caller.
  ElectricField(std::shared_ptr<Field const> potential, std::vector<Real3> factor);

  /// Of components in all cells.
  explicit ElectricField(std::array<std::shared_ptr<Field const>, 3> components);

  Hierarchy const& hierarchy() const { return *hierarchy_; }

  Rim const& rim(int level) const { return levels_[std::size_t(level)].rim; }
  /// The values there, as `write_cells` leaves them.
  Real const* at_rim(int level) const { return at_rims_.data() + levels_[std::size_t(level)].first; }
  Real* at_rim(int level) { return at_rims_.data() + levels_[std::size_t(level)].first; }
  static constexpr int rim_width = 3;

  Field const* potential() const { return potential_.get(); }  ///< null if components are given
  /// Only if they are given.
  Field const& component(int axis) const { return *components_[std::size_t(axis)]; }
  Real3 const& factor(int level) const { return levels_[std::size_t(level)].factor; }

  /// Take the values at the rim from those of plane k of a box, both counted from the first one of this rank. Before
  /// anyone reads them, `stream_end` must have been called.
  void set_rim(int level, int b, int k, std::array<Real const*, 3> const& plane);

  /// Write plane k of a box.
  void write_plane(int level, int b, int k, std::array<Real*, 3> const& plane) const;

  /// Write all cells.
  void write(std::array<Field*, 3> const& components) const;

 private:
  struct OnLevel {
    Rim rim;
    std::size_t first;  ///< of its values in `at_rims_`
    Real3 factor;
  };
  void make_rims();
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
  std::array<std::shared_ptr<Field const>, 3> components_;
  std::vector<OnLevel> levels_;
  LargeArray<Real> at_rims_;  ///< of all levels: one block, so that it is large
};

}  // namespace amrpic
