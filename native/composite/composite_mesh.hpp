#pragma once

#include <algorithm>
#include <array>
#include <map>
#include <memory>
#include <utility>
#include <vector>

#include "base/communicator.hpp"
#include "base/fetch.hpp"
#include "composite/composite_plan.hpp"
#include "mesh/field.hpp"
#include "mesh/metal_faces.hpp"
#include "mesh/transfer.hpp"
#include "multigrid/nearly_free.hpp"
#include "stencil/background.hpp"
#include "stencil/equation.hpp"
#include "stencil/field_difference.hpp"

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

enum class FullyCovered { visit, skip };  ///< boxes without uncovered cells
enum class Covered { visit, skip };       ///< cells that finer ones cover

/// Of what lies beyond a cell, among the cells of a layer of a box across an axis.
inline std::ptrdiff_t place_on_face(Box const& box, int axis, Index3 const& cell) {
  auto const [u, v] = tangential_axes(axis);
  return (cell[u] - box.lower[u]) + std::ptrdiff_t(box.extent(u)) * (cell[v] - box.lower[v]);
}

/// The cells of all levels, as what is done to them box by box sees them: the boxes of this rank, counted on each level
/// from its first one, and the lists of the plan.
class CompositeMesh {
 public:
  /// See CompositeLaplacian. Collective.
  CompositeMesh(std::shared_ptr<Hierarchy const> hierarchy, Real shift, Real3 const& stretch,
                Metal const* metal = nullptr);

  Hierarchy const& hierarchy() const { return *hierarchy_; }
  Communicator const& comm() const { return hierarchy_->comm(); }
  int levels() const { return hierarchy_->level_count(); }
  Level const& level(int l) const { return hierarchy_->level(l); }
  CompositePlan& plan() { return plan_; }
  CompositePlan const& plan() const { return plan_; }
  Transfer const& transfer() const { return transfer_; }
  LevelPlan& plan(int l) { return plan_.levels[std::size_t(l)]; }
  LevelPlan const& plan(int l) const { return plan_.levels[std::size_t(l)]; }
  BoxPlan const& plan(int l, int b) const { return plan(l).boxes[std::size_t(b)]; }
  int boxes(int l) const { return level(l).last_local_box() - level(l).first_local_box(); }
  Box const& box(int l, int b) const { return level(l).box(level(l).first_local_box() + b); }
  LocalIndex offset(int l, int b) const { return level(l).local_offset(level(l).first_local_box() + b); }

  Metal const* metal() const { return conductors_; }  ///< null if there is none anywhere
  /// In the boxes of this rank, and so many cells around them as metal reaches.
  MetalCells const& metal(int l) const { return metal_[std::size_t(l)].cells.cells; }
  /// The faces of an interface of a level that metal makes other than the rest, and those of coarse cells of which it
  /// takes a share.
  std::vector<MetalFace> const& metal_faces(int l, int interface) const {
    static std::vector<MetalFace> const none;
    auto const& of_level = metal_[std::size_t(l)].faces;
    return of_level.empty() ? none : of_level[std::size_t(interface)];
  }
  /// The refined side of its box at which a cell lies, by sides of the cell; of cut cells and such shares alone.
  RefinedSide const* finer_beyond(int l, Index3 const& cell, int side) const;
  std::vector<SharedFace> const& shared_faces(int l) const { return metal_[std::size_t(l)].cells.shared; }
  bool has_metal_faces() const { return has_metal_faces_; }  ///< on any rank
  /// A cut cell of a box: its equation, its place in its plane, and the sides, one bit each, beyond which a cell of the
  /// box lies that no finer ones cover.
  struct CutHere {
    CutCell const& cell;
    CutRow const& row;
    Index3 const& at;  ///< the indices of the cell
    std::ptrdiff_t place;
    std::uint8_t inside;
    int electrode;  ///< of all surfaces in its equation; -1 if there are several, or walls among them
    bool is_inside(std::size_t side) const { return inside >> side & 1; }
    bool is_inside() const { return inside == 63; }
  };
  bool has_metal(int l, int b) const;  ///< in a box, or beside its cells
  /// Call f(cut cell here) for those in plane k of a box, and solid(place, count, electrode) for runs of cells in
  /// metal.
  template <class F, class Solid>
  void for_each_in_metal(int l, int b, int k, Covered covered, F&& f, Solid&& solid) const {
    OfLevel const& of = metal_[std::size_t(l)];
    if (of.cells.cells.empty()) return;
    Plane const &plane = of.planes[std::size_t(of.first_plane[std::size_t(b)] + k)], &next = (&plane)[1];
    bool const all = covered == Covered::visit;
    for (int n = plane.first_cut, end = all ? next.first_cut : plane.covered_cut; n < end; ++n) {
      CutInPlane const& at = of.cuts[std::size_t(n)];
      f(CutHere{of.cells.cells.cut()[std::size_t(at.number)], at.row, at.cell, at.place, at.inside, at.electrode});
    }
    for (int n = plane.first_solid, end = all ? next.first_solid : plane.covered_solid; n < end; ++n) {
      SolidInPlane const& run = of.solids[std::size_t(n)];
      solid(std::ptrdiff_t(run.place), int(run.count), int(run.electrode));
    }
  }
  Equation equation(int l) const { return equation_on(level(l).spacing(), shift_); }
  bool is_nearly_free(int l) const {
    return !conductors_ && amrpic::is_nearly_free(level(l), hierarchy_->domain().boundary, shift_);
  }
  Real shift() const { return shift_; }
  Real volume(int l) const { return level(l).cell_volume() / (stretch_[0] * stretch_[1] * stretch_[2]); }
  Real factor_of_field(int l, int axis) const { return field_factor(level(l).spacing()[axis]) / stretch_[axis]; }

  std::size_t largest_row() const { return largest_row_; }  ///< cells of a box along any axis
  std::size_t largest_face(int axis) const {
    return largest_face_[axis];
  }  ///< cells of a plane of a box across an axis

  template <class F>
  void for_each_box(F&& f) const {
    for (int l = 0; l < levels(); ++l)
      for (int b = 0; b < boxes(l); ++b) f(l, b);
  }
  /// Call f(level, box) finest level first, and on each level the boxes that are remote(level, box) last: with the
  /// first of these `cells`, which are under way, have come. before(level) comes before these of a level, and
  /// after(level) after all.
  template <class Remote, class Before, class F, class After>
  void visit(RemoteReads& cells, FullyCovered fully_covered, Remote&& remote, Before&& before, F&& f,
             After&& after) const {
    bool waiting = true;
    for (int l = levels() - 1; l >= 0; --l) {
      for (bool last : {false, true}) {
        if (last && waiting) {
          cells.finish();
          waiting = false;
        }
        if (last) before(l);
        for (int b = 0; b < boxes(l); ++b)
          if (remote(l, b) == last && !(plan(l, b).is_fully_covered && fully_covered == FullyCovered::skip)) f(l, b);
      }
      after(l);
    }
    cells.settle();
  }
  /// Call f(place in the plane, count) for each row of covered cells in plane k of a box.
  template <class F>
  void for_each_covered_row(int l, int b, int k, F&& f) const {
    for (int c = plan(l, b).covered.first; c < plan(l, b).covered.last; ++c) {
      Box const& part = plan(l).covered[std::size_t(c)];
      if (k < part.lower[2] || k > part.upper[2]) continue;
      for (int j = part.lower[1]; j <= part.upper[1]; ++j)
        f(part.lower[0] + std::ptrdiff_t(j) * box(l, b).extent(0), part.extent(0));
    }
  }
  void clear_covered(int l, int b, int k, Real* plane) const;
  bool is_covered(int l, int b, Index3 const& cell) const;  ///< of a cell of the box

  /// Call f(place of the first, count) for the rows of cells of level l that others read.
  template <class F>
  void for_each_row_read(int l, Read const& read, F&& f) const {
    Box const part = read.cells();
    for_each_row(part, [&](Index3 const& first) {
      f(level(l).local_offset(read.owner) + std::int32_t(level(l).box(read.owner).offset(first)), part.extent(0));
    });
  }
  void pack_cells(Field const& field, int l, Read const& read, Real* out) const {
    Real const* const cells = field.level(l).data();
    for_each_row_read(l, read, [&](std::int32_t first, int count) { out = std::copy_n(cells + first, count, out); });
  }
  /// The same for the fluxes that level l leaves for cells that others have.
  template <class F>
  void for_each_flux_row_read(int l, Read const& read, F&& f) const {
    int const face = read.region % 6, b = read.owner - level(l).first_local_box();
    auto const [u, v] = tangential_axes(face / 2);
    Box const part = read.cells(), parents = box(l, b).coarsen(refinement_ratio);
    Interface const& i = plan(l).interfaces[std::size_t(plan(l, b).faces[std::size_t(face)].interface)];
    for (int y = part.lower[v]; y <= part.upper[v]; ++y)
      f(i.fluxes + (y - parents.lower[v] - i.v) * i.nu + part.lower[u] - parents.lower[u] - i.u, part.extent(u));
  }

  /// Round scale times a plane of cells into plane k of a block.
  template <class T>
  void write_plane(int l, int b, int k, Real const* plane, Real scale, Block<T> const& out) const {
    write_plane(l, b, k, plane, scale, out, [](Real const*, std::ptrdiff_t) {});
  }
  /// The same after take(cells, count) of parts of the plane: whole rows, as many as the nearest cache keeps.
  template <class T, class Take>
  void write_plane(int l, int b, int k, Real const* plane, Real scale, Block<T> const& out, Take&& take) const {
    constexpr int kept = 2048;
    int const nx = box(l, b).extent(0), ny = box(l, b).extent(1), rows = std::max(1, kept / nx);
    for (int first = 0; first < ny; first += rows) {
      int const count = std::min(ny - first, rows);
      Real const* const from = plane + std::ptrdiff_t(first) * nx;
      take(from, std::ptrdiff_t(count) * nx);
      write_rows(from, nx, count, scale, out.origin + first * out.pitch_y + k * out.pitch_z, out);
    }
  }
  /// Zeros into all planes of a block.
  template <class T>
  void clear(int l, int b, Block<T> const& out) const {
    for (int k = 0; k < box(l, b).extent(2); ++k)
      for (int j = 0; j < box(l, b).extent(1); ++j)
        std::fill_n(out.origin + j * out.pitch_y + k * out.pitch_z, box(l, b).extent(0), T(0));
  }

 private:
  void add_metal(int l);
  void add_metal_faces(int l);
  void add_refined_sides(int l);
  CutRow row_of(int l, CutCell const& cut) const;
  void place_metal(int l);
  void place_metal(int l, int b, int k, std::vector<char> const& covered, char which);
  /// Not inlined, so that the loop's pointers and factor stay in registers.
  template <class T>
  [[gnu::noinline]] static void write_rows(Real const* __restrict from, int nx, int rows, Real scale, T* __restrict to,
                                           Block<T> const& block) {
    std::ptrdiff_t const pitch = block.pitch_y, next = block.pitch_z;
    for (; rows > 0; --rows, from += nx, to += pitch) {
      fetch<Use::write>(to + next, nx);  // rows of a box lie far apart in vectors of the cycle
      for (int i = 0; i < nx; ++i) to[i] = T(scale * from[i]);
    }
  }

  std::shared_ptr<Hierarchy const> hierarchy_;
  Real shift_;
  Real3 stretch_;
  CompositePlan plan_;
  Transfer transfer_;
  Metal const* conductors_;
  struct CutInPlane {
    CutRow row;  ///< here, where residuals pass, as its place is
    Index3 cell;
    std::int32_t place, number;  ///< in the plane; of the cut cell
    // see CutHere
    std::uint8_t inside = 0;
    std::int32_t electrode = -1;
  };
  struct SolidInPlane {
    std::int32_t place, count, electrode;
  };
  struct Plane {  ///< uncovered cells come first
    std::int32_t first_cut, covered_cut, first_solid, covered_solid;
  };
  struct OfLevel {
    MetalOfLevel cells;
    std::vector<std::int32_t> first_plane;  ///< of each box
    std::vector<Plane> planes;              ///< box after box, and the end
    std::vector<CutInPlane> cuts;
    std::vector<SolidInPlane> solids;
    std::vector<std::vector<MetalFace>> faces;                    ///< of each interface
    std::map<std::pair<GlobalIndex, int>, std::int32_t> refined;  ///< of a cell's number in the domain, and its side
  };
  std::vector<OfLevel> metal_;
  bool has_metal_faces_ = false;
  std::size_t largest_row_ = 0;
  std::array<std::size_t, 3> largest_face_{0, 0, 0};
};

}  // namespace amrpic
