#pragma once

#include <functional>

#include "cycle/ghosts.hpp"
#include "cycle/parents.hpp"

namespace amrpic::cycle {

/// The colours of cells, and both of them: numbers that can be joined by |.
constexpr int colour_bit(int colour) { return 1 << colour; }
constexpr int both_colours = 3;

/// What is done to one plane of one block: to all its rows, or where stages follow each other level by level to some.
struct PlaneStage {
  std::function<void(std::size_t block, int plane, RowChoice const& rows)> act;
  int reads = 0;    ///< colours of neighbours whose corrections are read
  int changes = 0;  ///< colours of corrections that are changed
};

/// Run stages over all planes of a layout in one pass: stage s of a plane comes after stage s - 1 of the plane above
/// it, so that a plane stays in the cache from the first stage to the last. Plane after plane, `before` is called
/// before a stage reaches it.
void wavefront(Layout const& layout, std::vector<PlaneStage> const& stages, std::function<void(int)> const& before);

/// The acts on rows for one plane of a block (k in the level's indices).
class Sweep {
 public:
  Sweep(Layout const& layout, Stencil const& stencil);

  /// One colour (0 or 1: the parity of i + j + k) relaxed; from zero, the other becomes zero. In cells in metal values
  /// have no meaning until `is_last` sets zeros there; it does so each time where other cells take them.
  void relax(std::size_t block, int k, int colour, bool from_zero, bool is_last, RowChoice const& rows, Vector const& r,
             Vector& e) const;
  /// One colour of the cells beside metal alone.
  void relax_beside_metal(std::size_t block, int k, int colour, RowChoice const& rows, Vector const& r,
                          Vector& e) const;

  /// Set the parents of which the plane holds the last children: to `weight` times the sums of residuals, or of
  /// right-hand sides.
  template <bool of_residual>
  void restrict_to(std::size_t block, int k, Vector const& r, Vector& e, Parents const& parents, float weight,
                   Vector& coarse) const;

  /// Set e to the coarse correction, or add this.
  void prolong(std::size_t block, int k, RowChoice const& rows, Parents const& parents, Vector const& coarse, bool set,
               Vector const& r, Vector& e) const;

 private:
  template <class F>
  void for_each_row(std::size_t block, int k, RowChoice const& rows, F&& f) const;
  [[gnu::noinline]] float const* composed(std::size_t side, std::int32_t number, float const* e,
                                          bool differences) const;
  void keep_inner(MetalPlane const& plane, int colour, Vector const& e) const;
  void find_outer(MetalPlane const& plane, int colour, Vector const& r, Vector const& e) const;
  template <bool were_kept>
  void relax_inner(MetalPlane const& plane, int colour, Placement const& cells, Vector const& r, Vector& e) const;
  void place_outer(MetalPlane const& plane, int colour, Vector& e) const;
  void relax_cut_from_zero(MetalPlane const& plane, int colour, Vector const& r, Vector& e) const;
  void clear_solids(MetalPlane const& plane, Vector& e) const;
  /// Composes rows beside a row, or their differences to that.
  auto composer(float const* e, bool differences) const {
    return [=](std::size_t side, std::int32_t number) { return composed(side, number, e, differences); };
  }

  Layout const& layout_;
  Stencil const& stencil_;
  RowTable table_;
  mutable std::array<Vector, 4> buffer_;      ///< composed rows beside a row
  mutable std::vector<float> inner_, outer_;  ///< values of cut cells of a plane: those before a step, those after it
};

}  // namespace amrpic::cycle
