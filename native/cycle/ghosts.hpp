#pragma once

#include <algorithm>
#include <functional>
#include <optional>
#include <string>
#include <unordered_map>

#include "cycle/layout.hpp"
#include "cycle/row_table.hpp"
#include "mesh/faces.hpp"
#include "mesh/metal.hpp"
#include "stencil/equation.hpp"
#include "stencil/odd_extents.hpp"

namespace amrpic::cycle {

/// The value behind a face of a block in the equations of a correction e: factor * e[source] + first * (the cell before
/// the face). A neighbour's value has factor 1 and first 0; in other ghost cells `source` is the second
/// cell inside.
struct Ghost {
  std::int32_t source = 0;
  float factor = 0;
  float first = 0;
};

/// How the ghost cells of a level's corrections follow from its cells.
struct GhostRules {
  WallGhosts walls;
  /// More of `first` behind a wall than `walls` has: cell, axis, side.
  std::function<Real(Index3 const&, int, int)> more = nullptr;
  /// Outside the level but inside the domain: cell, axis, side. Not called where the level covers the domain.
  std::function<WallGhost(Index3 const&, int, int)> inside = nullptr;
  Real3 seam_width{1, 1, 1};                       ///< of the last cell along a periodic axis, see `UpperEnd`
  std::optional<WallGhost> inside_beside_metal{};  ///< as `inside`, where metal hides the second cell

  std::array<bool, 3> seams() const { return {seam_width[0] != 1, seam_width[1] != 1, seam_width[2] != 1}; }
};

inline Real smallest_spacing(Level const& level) {
  return std::min({level.spacing()[0], level.spacing()[1], level.spacing()[2]});
}

/// A cut cell with its neighbours beside it in a Vector.
struct InnerCut {
  std::array<float, 6> weight;
  float step;
};

/// A cut cell at an end of its block.
struct OuterCut {
  std::int32_t place;                  ///< in a Vector
  std::array<std::int32_t, 6> beside;  ///< places of the values beside it
  std::array<float, 6> weight;         ///< of these, with the factors of ghosts
  float step;
};

/// What metal makes of a plane of a block; cut cells by colour.
struct MetalPlane {
  struct Part {
    std::int32_t first = 0, last = 0;
  };
  std::array<Part, 2> inner, outer;
  Part solids;  ///< runs, whose places are those in a Vector
};

/// The rows of a level's blocks, for sweeps over a layout: see RowTable.
class Stencil {
 public:
  /// `faces`: of the blocks; `equation`: times h²; `relaxation`: factor of a Gauss-Seidel step; `metal`: in the domain,
  /// in as much of it as the blocks take.
  Stencil(Level const& level, Layout const& layout, LevelFaces const& faces, GhostRules const& rules,
          Equation const& equation, Real relaxation, bool in_differences, MetalCells const& metal);

  /// h² / h_d²; zero along axes of one cell that is its own neighbour: what cancels there does so before any rounding.
  std::array<float, 3> const& weight() const { return table_.weight; }
  /// The rows of a block, [j + ny k].
  Row const* rows(std::size_t block) const { return &rows_[std::size_t(first_row_[block])]; }
  RowTable table() const;  ///< in this memory
  /// Factor of what lies beyond a side of a cell of a block, counted from its first one.
  float weight_beyond(std::size_t block, int ny, Index3 const& at, std::size_t side) const;
  /// Of the equation of a cell of a block, counted from its first one; 0 in metal.
  float diagonal(std::size_t block, int ny, Index3 const& at) const;

  // What it consists of: rows and composed rows block after block.
  std::vector<Row> const& all_rows() const { return rows_; }
  std::vector<std::int32_t> const& first_rows() const { return first_row_; }           ///< of blocks, and the end
  std::vector<std::int32_t> const& first_composed() const { return first_composed_; }  ///< of blocks, and the end
  std::vector<ScaledRun> const& runs() const { return runs_; }
  std::vector<std::int32_t> const& first_runs() const { return first_run_; }
  Vector const& coefficients() const { return pool_; }
  std::vector<std::int32_t> const& metal_of() const { return metal_of_; }  ///< of each row, if any has metal
  std::vector<MetalRow> const& metal_rows() const { return metal_rows_; }
  std::vector<CutPlace> const& cuts() const { return cuts_; }
  std::vector<SolidRun> const& solids() const { return solids_; }
  // The same by planes, for a thread that sweeps whole ones.
  MetalPlane const& metal_plane(std::size_t block, int plane) const {  ///< counted from the block's first
    return metal_planes_[std::size_t(first_plane_[block] + plane)];
  }
  InnerCut const* inner_cuts() const { return inner_cuts_.data(); }
  std::int32_t const* inner_places() const { return inner_places_.data(); }  ///< of these in a Vector
  OuterCut const* outer_cuts() const { return outer_cuts_.data(); }
  std::vector<SolidRun> const& solids_in_planes() const { return solids_in_planes_; }
  /// Whether equations of cells have values in metal: of covered ones behind faces of which finer cells take a part.
  bool reads_solids() const { return reads_solids_; }
  std::size_t bytes() const;

 private:
  CutPlace const* cut_at(std::size_t row, int place) const;  ///< null where the cell of a row is not cut
  bool is_solid(std::size_t row, int place) const;
  static std::vector<Ghost> ghosts(Level const& level, Layout const& layout, GhostRules const& rules,
                                   MetalCells const& metal, CellBlock const& block, Face const& face, int axis,
                                   int side);
  void add_rows(Layout const& layout, std::size_t block,
                std::array<std::array<std::vector<Ghost>, 2>, 3> const& ghosts);
  std::int32_t compose(Ghost const* ghosts, int n, std::ptrdiff_t own, std::ptrdiff_t zero_row);
  void add_coefficients(Row* rows, CellBlock const& block,
                        std::array<std::array<std::vector<Ghost>, 2>, 3> const& ghosts);
  void add_metal(Level const& level, CellBlock const& block, BoxFaces const& faces, GhostRules const& rules,
                 std::array<std::array<std::vector<Ghost>, 2>, 3> const& ghosts, Equation const& equation,
                 MetalCells const& metal, Row* rows);
  void add_metal_row(Row const& row, std::array<std::vector<CutPlace>, 2> const& cuts,
                     std::vector<SolidRun> const& solids);
  template <class F>
  void for_each_metal_row(Row const* first, int count, F&& f) const;
  void add_metal_planes(CellBlock const& block, Row const* rows);
  OuterCut outer_cut(Row const& row, CutPlace const& cut) const;
  std::int32_t pooled(std::size_t pitch, std::vector<float> const& diagonal, std::vector<float> const& held);

  Real relaxation_;
  float shift_;
  RowTable table_{};  ///< without lists
  std::vector<Row> rows_;
  std::vector<std::int32_t> first_row_, first_composed_;
  std::vector<ScaledRun> runs_;
  std::vector<std::int32_t> first_run_{0};
  Vector pool_;  ///< coefficients, which many rows share
  std::unordered_map<std::string, std::int32_t> known_;
  std::vector<std::int32_t> metal_of_;
  std::vector<MetalRow> metal_rows_;
  std::vector<CutPlace> cuts_;
  std::vector<SolidRun> solids_;
  std::vector<std::int32_t> first_plane_;  ///< of blocks
  std::vector<MetalPlane> metal_planes_;
  std::vector<InnerCut> inner_cuts_;
  std::vector<std::int32_t> inner_places_;
  std::vector<OuterCut> outer_cuts_;
  std::vector<SolidRun> solids_in_planes_;
  bool reads_solids_ = false;
  mutable std::vector<float> cut_values_;
};

}  // namespace amrpic::cycle
