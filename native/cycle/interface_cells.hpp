#pragma once

#include <memory>

#include "cycle/ghosts.hpp"
#include "cycle/interface_acts.hpp"
#include "cycle/layout.hpp"
#include "mesh/faces.hpp"
#include "mesh/fits.hpp"
#include "mesh/gap_values.hpp"
#include "mesh/metal_faces.hpp"

namespace amrpic::kokkos {
class InterfaceCells;  // the same on Kokkos, by the same lists
}

namespace amrpic::cycle {

/// A copy, in a Vector, of a block's parents and the coarser cells next to them, whichever ranks own these.
struct CoarsePatch {
  Box box;  ///< on the coarser level
  Placement cells;
  std::ptrdiff_t place(Index3 const& c) const {
    return cells.place(c[0] - box.lower[0], c[1] - box.lower[1], c[2] - box.lower[2]);
  }
};

/// Conductors, null if there are none; the level before the coarser one; and the equation of that one, scaled.
struct MetalBeside {
  Metal const* metal = nullptr;
  Level const* coarsest = nullptr;
  Equation coarse_equation{};
};

/// The faces between own cells of a level and uncovered cells of the next coarser one, in the equations of corrections.
class InterfaceCells {
 public:
  InterfaceCells() = default;
  /// `finer`: the next finer level, null if there is none; `faces`: of the blocks; `patches`: of the own blocks, with
  /// two cells around the parents; `stencil`: of this level; `coarse_weight`: of that of the coarser one.
  InterfaceCells(Level const& level, Level const& coarser, Level const* finer, Layout const& layout,
                 LevelFaces const& faces, std::vector<CoarsePatch> const& patches, Stencil const& stencil,
                 std::array<float, 3> const& coarse_weight, std::shared_ptr<GapFits> gap_fits,
                 MetalBeside const& metal = {});

  /// Take from r what the ghosts behind the faces have of the coarser correction.
  void subtract_coarse(Vector const& coarse_values, Vector& r) const;

  /// Take from r what ghosts in narrow gaps have of the fine correction by their fits, which sweeps do not see, less
  /// what was taken before; of a correction of zero, from which a cycle starts, nothing was.
  void start() { std::fill(taken_.begin(), taken_.end(), FourStars<float>{}); }
  void subtract_in_gaps(Vector const& e, Vector& r);

  /// Take from the coarser cells behind the faces what the fine correction sends through these; in gaps with the parts
  /// of ghosts that were taken last.
  void subtract_flux(Vector const& e, Vector& coarse_values) const;

  std::size_t bytes() const;

 private:
  friend class kokkos::InterfaceCells;
  /// A side of a block on which ghosts lie in coarser cells: nu x nv of these, the lower tangential axis first.
  struct InterfaceSide : InterfaceSteps {
    int nu, nv;
    std::size_t fits;               ///< first of its numbers, u fastest; no_fit where no ghosts lie
    std::ptrdiff_t cell, parent;    ///< the first fine cell before the face, and coarse cell behind it, in the patch
    std::ptrdiff_t parent_normal;   ///< step between coarse cells along the normal
    std::size_t first_gap, gaps;    ///< fits in gaps, u fastest
    std::size_t first_part, parts;  ///< of the region around them
    Box region;                     ///< fine cells
    Index3 first_child;             ///< of the first coarse cell
    int axis, side;
  };
  /// Cells of the level in a block.
  struct RegionPart {
    Box part;
    Placement from;
  };
  void add_gaps(InterfaceSide& face, ArrayOnBox<FitNumber> const& fits, std::vector<Overlap> const& near,
                std::vector<Overlap> const& refined, Level const& level, Level const* finer, Layout const& layout);
  /// The first of the fine cells before a coarse face.
  static std::size_t first_cell(InterfaceSide const& face, int u, int v) {
    return std::size_t(face.cell + 2 * (u * face.cell_u + v * face.cell_v));
  }
  struct MetalSide : MetalSteps {
    int direction;                                                ///< 2 axis + side
    std::vector<std::pair<std::int32_t, FourStars<Real>>> terms;  ///< phi* by the values at places
  };
  void add_metal(InterfaceSide const& face, Box const& parents, std::size_t block, CellBlock const& cells,
                 LevelsInMetal const& levels, Stencil const& stencil, MetalCells const& coarse_rows,
                 Equation const& coarse_equation, ArrayOnBox<FitNumber>& fits);
  template <class F>
  void for_each_gap(InterfaceSide const& face, F&& f) const;
  std::vector<InterfaceSide> faces_;
  std::vector<MetalSide> metal_;
  std::vector<FitNumber> fits_;
  std::shared_ptr<GapFits> gap_fits_;
  std::vector<GapFit const*> gaps_;
  std::vector<FourStars<float>> taken_;  ///< of each gap
  std::vector<RegionPart> parts_;
  GapValues<float> gap_values_;
  mutable std::vector<float> plane_, rows_;  ///< of the face under way: coarse values, two rows of ghosts
};

}  // namespace amrpic::cycle
