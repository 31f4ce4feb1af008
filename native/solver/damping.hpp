#pragma once

#include "composite/composite_mesh.hpp"
#include "cycle/cycle.hpp"

namespace amrpic {

/// What corrections of the seven-point cycle have too much of, for a residual of fourth order.
///
/// Of errors that alternate from cell to cell along all axes the cycle finds 4/3 times as much as there is, of smooth
/// ones what there is. A multiple of the residual takes most of that back: with S the symbol of -h² times the
/// seven-point Laplacian, by which the cycle divides, a correction e is left with (1 - c S) e. With c = 1/48 in cubes
/// that is 3/4 where S is largest, 12, and what is then found of any error lies between 1 and 11/9 of it, where it is
/// largest for those that alternate along one axis alone.
///
/// The last sweep over a level has both at hand, and needs the residual no more: the damped correction takes its place.
/// Beside coarse-fine faces the cycle has taken from residuals what corrections beyond them do. There the finer cells
/// are left as they are, and the coarser ones, whose residuals are remembered, damped as others.
class Damping {
 public:
  /// `residual`: the blocks of the cycle, to which a stage is added on each level.
  Damping(CompositeMesh const& mesh, Blocks<float> const& residual, cycle::Cycle& cycle);
  Damping(Damping const&) = delete;  // the stages refer to it
  Damping& operator=(Damping const&) = delete;

  /// A cycle, after which the residuals are damped corrections. Collective.
  void run();

  std::size_t bytes() const;

 private:
  /// Cells in line, in a plane of a level, before coarse-fine faces.
  struct Run {
    int plane;
    int count;
    float* first;
    std::ptrdiff_t step;
    std::ptrdiff_t remembered;  ///< place of the first one; -1: cells of the finer level
  };
  void add_interfaces(int l, int b, Blocks<float> const& residual);
  void add_refined(int l, int b, Blocks<float> const& residual);
  Run& add_run(int l, int b, Blocks<float> const& residual, Index3 const& first, int axis, int count);
  void remember();
  void act(int l, std::size_t block, int plane);
  void prepare(int l, int plane);
  float weight(int l, int axis, int index) const;

  CompositeMesh const& mesh_;
  cycle::Cycle& cycle_;
  std::vector<float> factor_;           ///< c, of each level
  std::vector<std::vector<Run>> runs_;  ///< of each level, plane after plane
  std::vector<float> remembered_;
  int prepared_ = 0;  ///< the latest plane of the level under way
  bool acts_ = false;
};

}  // namespace amrpic
