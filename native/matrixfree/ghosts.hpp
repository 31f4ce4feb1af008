#pragma once

#include <algorithm>
#include <functional>
#include <string>
#include <unordered_map>

#include "matrixfree/layout.hpp"
#include "mesh/faces.hpp"
#include "stencil/equation.hpp"
#include "stencil/odd_extents.hpp"

namespace amrpic::matrixfree {

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
  Real3 seam_width{1, 1, 1};  ///< of the last cell along a periodic axis, see `UpperEnd`

  std::array<bool, 3> seams() const { return {seam_width[0] != 1, seam_width[1] != 1, seam_width[2] != 1}; }
};

/// A run of values of a row: factor * e[source + i] for `count` cells from `place` on; of differences, factor *
/// (e[source + i] - e[own + i]).
struct ScaledRun {
  std::int32_t place, count;
  std::int32_t source;
  float factor;
  std::int32_t own;  ///< the first of the cells that the row lies beside
};

inline Real smallest_spacing(Level const& level) {
  return std::min({level.spacing()[0], level.spacing()[1], level.spacing()[2]});
}

/// The neighbours of a row along x. The row on a side is a piece of memory, or composed of runs.
struct RowStencil {
  std::array<std::int32_t, 4> beside;  ///< y below, above, z below, above: the place in a Vector, or ~(composed row)
  std::array<std::int32_t, 2> end;     ///< places of the values before the first and after the last cell
  std::array<float, 2> factor;         ///< of these
  std::int32_t coefficients;           ///< where the row's coefficients start
};

/// All about a block that its sweeps need besides e and r.
struct BlockStencil {
  std::vector<RowStencil> rows;         ///< [j + ny k]
  std::vector<ScaledRun> runs;          ///< of composed rows
  std::vector<std::int32_t> first_run;  ///< composed row c: [first_run[c], first_run[c + 1])
};

/// The operator h² L of a level as if nothing finer existed, h the smallest spacing, over the blocks of a layout:
/// S e - d e, S the weighted sum over neighbours, d the diagonal with what ghosts add to it.
class Stencil {
 public:
  /// `faces`: of the blocks; `equation`: times h²; `relaxation`: factor of a Gauss-Seidel step.
  Stencil(Level const& level, Layout const& layout, LevelFaces const& faces, GhostRules const& rules,
          Equation const& equation, Real relaxation, bool in_differences);

  BlockStencil const& block(std::size_t b) const { return blocks_[b]; }
  /// h² / h_d²; zero along axes of one cell that is its own neighbour: what cancels there does so before any rounding.
  std::array<float, 3> const& weight() const { return weight_; }
  bool isotropic() const { return weight_[0] == weight_[1] && weight_[1] == weight_[2]; }
  float keep() const { return keep_; }  ///< 1 - relaxation

  // Coefficients of a row are three vectors over its cells: the diagonal d, then relaxation / d of even and of odd
  // places, zero in between. Many rows share them.
  float const* diagonal(std::int32_t start) const { return &pool_[std::size_t(start)]; }
  float const* step(std::int32_t start, std::ptrdiff_t pitch, int parity) const {
    return &pool_[std::size_t(start)] + (1 + parity) * pitch;
  }
  Vector const& coefficients() const { return pool_; }

  /// Whether residuals are taken of differences between neighbours, see `is_nearly_free`: the sum over neighbours less
  /// d e is then that over the differences to them less `held` times e.
  bool in_differences() const { return in_differences_; }
  float const* held(std::int32_t start, std::ptrdiff_t pitch) const { return diagonal(start) + held_place * pitch; }
  static constexpr int held_place = 3;  ///< among the vectors of a row's coefficients
  std::size_t bytes() const;

 private:
  static std::vector<Ghost> ghosts(Level const& level, Layout const& layout, GhostRules const& rules,
                                   CellBlock const& block, Face const& face, int axis, int side);
  static void add_rows(BlockStencil& out, Layout const& layout, CellBlock const& block,
                       std::array<std::array<std::vector<Ghost>, 2>, 3> const& ghosts);
  static std::int32_t compose(BlockStencil& out, Ghost const* ghosts, int n, std::ptrdiff_t own,
                              std::ptrdiff_t zero_row);
  void add_coefficients(BlockStencil& out, CellBlock const& block,
                        std::array<std::array<std::vector<Ghost>, 2>, 3> const& ghosts);
  std::int32_t pooled(CellBlock const& block, std::vector<float> const& diagonal, std::vector<float> const& held);

  Real relaxation_;
  std::array<float, 3> weight_;
  float shift_;
  float keep_;
  bool in_differences_;
  std::vector<BlockStencil> blocks_;
  Vector pool_;
  std::unordered_map<std::string, std::int32_t> known_;
};

}  // namespace amrpic::matrixfree
