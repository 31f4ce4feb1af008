#pragma once

#include "matrixfree/layout.hpp"
#include "stencil/interface.hpp"

namespace amrpic::matrixfree {

/// The coarser cells around a block's own parents, in a Vector: a copy, wherever the cells live.
struct Surroundings {
  Box box;  ///< on the coarser level
  Rectangle cells;
  std::ptrdiff_t place(Index3 const& c) const {
    return cells.place(c[0] - box.lower[0], c[1] - box.lower[1], c[2] - box.lower[2]);
  }
};

/// The faces between own cells of a level and uncovered cells of the next coarser one, as corrections see them.
class InterfaceCells {
 public:
  InterfaceCells() = default;
  /// `surroundings`: of the own blocks, two cells wide; weights: those of the stencils of this level and the coarser
  /// one.
  InterfaceCells(Level const& level, Level const& coarser, Layout const& layout,
                 std::vector<Surroundings> const& surroundings, std::array<float, 3> const& weight,
                 std::array<float, 3> const& coarse_weight);

  bool empty() const { return groups_.empty(); }

  /// Take from r what the ghosts behind the faces have of the coarser correction.
  void subtract_coarse(Vector const& surroundings, Vector& r) const;

  /// Take from the coarser cells behind the faces what the fine correction sends through these.
  void subtract_flux(Vector const& e, Vector& surroundings) const;

  std::size_t bytes() const;

 private:
  typedef float Four __attribute__((vector_size(16)));
  /// The four fine faces of one coarse face; their ghosts lie in one coarse cell.
  struct Group {
    std::int32_t cell;    ///< the first of the fine cells before the faces
    std::int32_t parent;  ///< the coarse cell behind them
    std::int32_t fit;
  };
  struct Face {
    std::size_t end;                       ///< of its groups
    std::ptrdiff_t inward;                 ///< from a fine cell to the next one
    std::array<std::ptrdiff_t, 4> member;  ///< from the first fine cell to each
    float weight, flux_weight;
    std::vector<std::array<std::ptrdiff_t, 9>> steps;  ///< of each fit, from the parent to its terms
  };
  struct Fit {
    int count;
    Four weight[9];  ///< of each term in the four ghosts
  };
  std::vector<Group> groups_;
  std::vector<Face> faces_;
  std::vector<Fit> fits_;
};

}  // namespace amrpic::matrixfree
