// What metal leaves of the faces between levels.
#pragma once

#include <array>
#include <optional>
#include <vector>

#include "mesh/fits_behind.hpp"
#include "mesh/metal.hpp"
#include "stencil/interface.hpp"
#include "stencil/linear_ghost.hpp"

namespace amrpic {

/// A face of a cell with four finer cells before it, seen from these: the cell lies behind it on a side of an axis.
struct CoarseFace {
  Index3 coarse;
  int axis, side;

  std::size_t outward() const { return std::size_t(2 * axis + side); }  ///< side of the finer cells
  std::size_t inward() const { return std::size_t(2 * axis + 1 - side); }
  /// The finer cells, by halves along the lower and the higher tangential axis.
  Index3 fine(int a, int b) const {
    auto const [u, v] = tangential_axes(axis);
    Index3 out = first_child_of(coarse);
    out[axis] += side == 0 ? 2 : -1;
    out[u] += a, out[v] += b;
    return out;
  }
};

/// A coarse face with metal about. Finer cells that see the coarse one, past surfaces that arms on the way meet, are
/// linked to it; what flows through the faces of others ends on metal, and the coarse cell
/// takes the mean flux of linked ones for that of its whole face: it is exact for linear potentials.
struct MetalFace {
  struct CellTerm {
    int i, j;  ///< of a cell of the coarse plane, see `PlaneFit`
    FourStars<Real> weight;
  };
  struct SurfaceTerm {
    int electrode;
    FourStars<Real> weight;
  };

  CoarseFace at;
  FourStars<char> linked{}, linear{};  ///< linear: metal hides the second cell, which ghosts do without
  int links = 0;
  std::vector<CellTerm> cells;  ///< phi* behind linked cells, with `surfaces`
  std::vector<SurfaceTerm> surfaces;

  Real first(std::size_t a, std::size_t b) const { return linear[b][a] ? linear_ghost::first : interface_ghost::first; }
  Real second(std::size_t a, std::size_t b) const { return linear[b][a] ? 0 : interface_ghost::second; }
  Real star(std::size_t a, std::size_t b) const {
    return linear[b][a] ? linear_ghost::coarse : interface_ghost::coarse;
  }
  Real of_links() const { return 4.0 / links; }  ///< weight of their differences in the coarse one
};

/// Two neighbouring levels, and metal as each sees it by itself.
class LevelsInMetal {
 public:
  /// `coarse`, `fine`: cells around the faces that are asked about.
  LevelsInMetal(Level const& coarser, Level const& finer, MetalCells coarse, MetalCells fine);

  /// Where the arm of a finer cell ends that is not linked to the coarse one.
  struct End {
    Real arm;  ///< 0 in metal
    int electrode;
  };
  std::optional<End> end(CoarseFace const& face, int a, int b) const;
  Index3 wrapped(Index3 const& coarse) const { return coarser_.wrapped(coarse); }
  bool is_near(CoarseFace const& face) const;  ///< whether its cells may be cut, or in metal

  /// The face, if metal makes it other than those with this fit.
  std::optional<MetalFace> beside_metal(CoarseFace const& face, FitNumber fit) const;

 private:
  bool is_usable(Index3 const& coarse) const;
  bool is_clean(Index3 const& middle, int axis, int placement) const;
  void add_block(int placement, MetalFace& to) const;
  void add_slopes(MetalFace& to) const;

  Level const &coarser_, &finer_;
  MetalCells coarse_, fine_;
  Box near_coarse_, near_fine_;
};

/// A face of a coarse cell of which metal takes a share.
struct SharedFace {
  Index3 cell;
  std::size_t side;
  Real share;
  int electrode;
};

/// The cells of a level in and beside metal with arms as its equations have them: at faces between levels those of
/// finer cells that are not linked end on metal, or far away where there is none on their line, which drops the axis;
/// those of coarse ones end only if none is linked.
struct MetalOfLevel {
  MetalCells cells;
  std::vector<SharedFace> shared;
};
/// In boxes, and perhaps others. `coarser`: null if there is none; `finer`: levels, coarse to fine, of which the first
/// refines this one; `holds`: whether cells have those of metal that these see alone. Local.
MetalOfLevel metal_of_level(Metal const& metal, Level const& level, Level const* coarser,
                            std::vector<Level const*> const& finer, std::vector<Box> const& boxes, bool holds);

}  // namespace amrpic
