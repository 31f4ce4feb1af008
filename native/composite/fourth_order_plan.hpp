#pragma once

#include "composite/composite_mesh.hpp"
#include "stencil/fourth_order.hpp"

namespace amrpic {

/// What the ghosts of fourth order take beside the lists of CompositePlan: two layers of cells of the level beyond each
/// face, and of coarser cells, covered ones included, since they hold the means of their children.
class FourthOrderPlan {
 public:
  /// Collective.
  explicit FourthOrderPlan(CompositeMesh const& mesh);

  static constexpr int layers = fourth_order::ghost_layers;
  static constexpr int margin = fourth_order::MeansBlock::reach;  ///< coarse cells around those behind a face

  struct FacePlan {
    std::array<Range, layers> neighbours;  ///< rectangles of the level, by layers from the face
    std::array<Range, layers> coarse;      ///< rectangles of the coarser level, placed in the array with its margin
    int nu = 0, nv = 0;                    ///< coarse cells behind the face, without the margin
    std::int32_t blocks = -1;              ///< place of those of these cells, u fastest; -1: no coarser cells
  };
  /// Of each layer, for a coarse cell behind a face.
  using OfCell = std::array<fourth_order::MeansBlock, layers>;

  struct OnLevel {
    std::vector<std::array<FacePlan, 6>> faces;  ///< of the boxes of this rank
    std::vector<char> remote;                    ///< of each of these boxes: whether it takes values from other ranks
    std::vector<Rectangle> rectangles;
    std::vector<OfCell> blocks;
  };
  FacePlan const& face(int l, int b, int f) const {
    return levels_[std::size_t(l)].faces[std::size_t(b)][std::size_t(f)];
  }
  bool is_remote(int l, int b) const { return levels_[std::size_t(l)].remote[std::size_t(b)]; }
  OnLevel const& level(int l) const { return levels_[std::size_t(l)]; }

  RemoteReads cells;  ///< of other ranks, of all levels
  static int as_neighbours(int l) { return 2 * l; }
  static int behind_edges(int l) { return 2 * l + 1; }
  static int level_of(int purpose) { return purpose / 2; }

  std::size_t bytes() const;

 private:
  void plan_face(CompositeMesh const& mesh, int l, int b, int f, Face const& face);

  std::vector<OnLevel> levels_;
};

}  // namespace amrpic
