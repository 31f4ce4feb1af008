#pragma once

#include <functional>

#include "composite/coarse_fluxes.hpp"
#include "composite/fourth_order_plan.hpp"
#include "mesh/walls.hpp"

namespace amrpic {

/// The two layers of ghost cells around one box after the other, and the fluxes that finer levels leave for coarser
/// ones, so that each face has one flux. As CompositeGhosts, in fourth order.
class FourthOrderGhosts {
 public:
  /// Collective.
  explicit FourthOrderGhosts(CompositeMesh& mesh);

  static constexpr int layers = FourthOrderPlan::layers;

  /// What stands behind walls and coarse-fine faces.
  enum class Ends {
    ghosts,    ///< what walls and coarser cells make of it
    of_field,  ///< the same, but behind Dirichlet walls what the cells before them make of it: for E
    faces,     ///< beyond coarse-fine faces, in the first layer, the value on the face; nothing is done at walls
    nothing    ///< not a number
  };

  /// Call f(level, box) for all boxes of this rank, finest level first, with the ghosts of the box at hand and the
  /// fluxes from the finer level through its faces. `walls` may be null where the ends have no ghosts. Collective.
  void visit(Field const& phi, std::vector<Walls> const* walls, Ends ends, FullyCovered fully_covered,
             std::function<void(int, int)> const& f);

  /// Take a box under way whose level and those around it are zero, so that ghosts are what wall data make them. Local.
  void visit_zero(int l, int b, Walls const& walls);

  /// Those of the box under way beyond a face, in a layer counted from it, the lower tangential axis fastest.
  Real const* ghosts(int axis, int side, int layer) const {
    return ghosts_[std::size_t(2 * axis + side)][std::size_t(layer)].data();
  }

  /// The value in a cell of the box under way, or of a ghost: `cell` may be two cells beyond it along `axis`.
  Real value(Box const& own, Real const* phi, int axis, Index3 const& cell) const {
    int const n = cell[axis], extent = own.extent(axis);
    if (n >= 0 && n < extent)
      return phi[cell[0] + std::ptrdiff_t(own.extent(0)) * (cell[1] + std::ptrdiff_t(own.extent(1)) * cell[2])];
    auto const [u, v] = tangential_axes(axis);
    return ghosts(axis, n < 0 ? 0 : 1, n < 0 ? -n - 1 : n - extent)[cell[u] + std::ptrdiff_t(cell[v]) * own.extent(u)];
  }

  /// The values in line with a cell along an axis: of the one `n` cells further.
  auto in_line(Box const& own, Real const* phi, int axis, Index3 const& cell) const {
    return [this, &own, phi, axis, cell](int n) {
      Index3 there = cell;
      there[axis] += n;
      return value(own, phi, axis, there);
    };
  }

  /// Row (j, k) of the box under way at [2], and the rows n cells further along an axis at [2 + n], n from -2 to 2.
  /// Along x these are parts of a line with its ghosts, as long as no other is asked for.
  std::array<Real const*, 2 * layers + 1> rows_in_line(Box const& own, Real const* phi, int axis, int j, int k);

  /// Call f(axis, first cell, count, excess) for the rows of uncovered cells of a plane with refined cells beyond their
  /// faces; excess(x) is the difference of phi across the face of a cell of the row, outwards, by the finer fluxes,
  /// less that by the level's cells, which are row(axis, cell)[0], [1], ..., up to two cells away from the row.
  template <class Row, class F>
  void for_each_refined(int l, int b, int k, Row&& row, F&& f) const {
    fluxes_.for_each_refined_row(
        l, b, k, k, [&](RefinedSide const& r, Index3 const& cell, int count, Real const* flux, std::ptrdiff_t step) {
          auto const at = [&](int n) -> Real const* {
            Index3 there = cell;
            there[r.axis] += r.side == 0 ? -n : n;
            return row(r.axis, there);
          };
          Real const *const inside = at(-1), *const own = at(0), *const near = at(1), *const far = at(2);
          static constexpr Real none = 0;
          Real const* const finer = zero_ ? &none : flux;
          std::ptrdiff_t const apart = zero_ ? 0 : step;
          f(r.axis, cell, count, [=](int x) {
            return fine_face_weight * finer[x * apart] - fourth_order::difference(inside[x], own[x], near[x], far[x]);
          });
        });
  }

  /// After Ends::faces, call f(axis, side, cells) for the cells of a box at a face with coarser ones beyond; the values
  /// on the face are their ghosts of the first layer, zero where nothing coarser is in front of a cell. And f(side,
  /// first cell, count, sums, how far apart these are) for the rows of uncovered cells with refined ones beyond their
  /// faces, of the four values on each of these.
  template <class F>
  void for_each_coarse_face(int l, int b, F&& f) const {
    for (int face = 0; face < 6; ++face) {
      if (plan_.face(l, b, face).blocks < 0) continue;
      int const axis = face / 2, side = face % 2;
      auto const [u, v] = tangential_axes(axis);
      Interface const& i = mesh_.plan(l).interfaces[std::size_t(mesh_.plan(l, b).faces[std::size_t(face)].interface)];
      Box cells = mesh_.box(l, b).shift_back(mesh_.box(l, b).lower).layer(axis, side, 0);
      cells.lower[u] = 2 * i.u, cells.upper[u] = 2 * (i.u + i.nu) - 1;
      cells.lower[v] = 2 * i.v, cells.upper[v] = 2 * (i.v + i.nv) - 1;
      f(axis, side, cells);
    }
  }
  template <class F>
  void for_each_refined_face(int l, int b, F&& f) const {
    fluxes_.for_each_refined_row(l, b, 0, mesh_.box(l, b).extent(2) - 1, f);
  }

  /// The ghosts behind a wall of a level, of as many cells as lie between it and the next end of the level, up to those
  /// that they take.
  fourth_order::WallGhosts const& wall_ghosts(int l, int axis, int side, int cells) const {
    Boundary const kind = mesh_.hierarchy().domain().boundary[std::size_t(axis)][std::size_t(side)];
    return polynomial_at_wall(l, axis, side, std::min(cells, fourth_order::cells_at_wall(kind)));
  }
  /// How many cells in line from a face of the box under way inwards the level has, and are at hand, up to `most`.
  int cells_inside(int l, int b, int axis, int side, int u, int v, int most = fourth_order::wall_cells) const;

  std::size_t bytes() const;

 private:
  void fill(int l, int b, Field const& phi, Walls const* walls, Ends ends);
  std::array<Real const*, fourth_order::wall_cells> cells_at(Box const& own, Real const* phi, int axis, int side, int u,
                                                             int v, int count);
  void fill_wall(int l, int b, int axis, int side, Ends ends, Real const* phi, Walls const& walls, int first);
  bool fill_open_wall(int l, int b, int axis, int side, Walls const& walls, int first);
  void extrapolate(int l, int b, int axis, int side, Real const* phi);
  fourth_order::WallGhosts const& polynomial_at_wall(int l, int axis, int side, int cells) const {
    return wall_ghosts_[std::size_t(l)][std::size_t(2 * axis + side)][std::size_t(cells)];
  }
  void fill_interface(int l, int b, int axis, int side, Field const& phi);
  void fill_faces(int l, int b, int axis, int side, Field const& values);
  void read_coarse(int l, int b, int f, Field const& values);
  void fit_row(int layer, FourthOrderPlan::OfCell const* blocks, FitNumber const* fits, int count, Real const* coarse,
               std::ptrdiff_t pitch);
  void fit_central(int layer, int begin, int end, int count, Real const* coarse, std::ptrdiff_t pitch);
  void fit_cell(int layer, fourth_order::MeansBlock const& block, int m, int count, Real const* coarse,
                std::ptrdiff_t pitch);
  void fill_in_front(int l, int b, int axis, int side, Interface const& i, int row, int begin, int end, bool deep,
                     Real const* cells, Real* flux);

  CompositeMesh& mesh_;
  FourthOrderPlan plan_;
  using OfWalls = std::array<std::array<fourth_order::WallGhosts, fourth_order::wall_cells + 1>, 6>;
  std::vector<OfWalls> wall_ghosts_;                                                ///< [level][face][cells]
  std::array<std::array<fourth_order::InterfaceGhosts, 4>, 3> interface_ghosts_{};  ///< [coarse][fine cells]
  /// [size][- first cell]: half weights of blocks along an axis.
  std::array<
      std::array<std::array<std::array<Real, fourth_order::MeansBlock::most>, 2>, fourth_order::MeansBlock::most>,
      fourth_order::MeansBlock::most + 1>
      half_weights_{};
  fourth_order::Extrapolation extrapolation_ = fourth_order::make_extrapolation();
  bool zero_ = false;  ///< whether the box under way is of `visit_zero`
  CoarseFluxes fluxes_;
  std::array<std::array<std::vector<Real>, layers>, 6> ghosts_;  ///< of the box under way
  std::array<std::vector<Real>, layers> coarse_, star_;  ///< of the interface under way: coarse means, those over the
                                                         ///< fine cells' faces in two rows
  std::vector<Real> columns_;                            ///< of a row of blocks: sums across it
  std::array<std::vector<Real>, fourth_order::wall_cells> lines_;  ///< of a row of cells at a face across x
  std::vector<Real> differences_;                                  ///< across the faces of a row of fine cells
  std::vector<Real> line_;                                         ///< a row with its ghosts before and behind
};

}  // namespace amrpic
