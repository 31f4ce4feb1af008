// Matrices of degree 1 on bricks: each node's row has blocks for itself and its 26 neighbours, and so have those of
// coarser bricks.
#pragma once

#include <memory>
#include <vector>

#include "fem/operators.hpp"
#include "mesh/box_regions.hpp"

namespace amrpic::fem {

constexpr int stencil = 27;  ///< neighbours of a node, x fastest, itself in the middle

/// The rows of this rank's nodes: of each node 27 blocks of components x components, rows of a block one by one.
struct NodeBlocks {
  std::shared_ptr<Level const> nodes;
  int components;
  std::vector<Real> free;  ///< of each own unknown 1, or 0 where it is fixed: its row and column are zeros
  std::vector<Real> value;

  std::size_t width() const { return std::size_t(stencil * components * components); }
};

/// The rows of an operator of degree 1, from its elements' matrices. Collective.
NodeBlocks node_blocks(Operator const& a, std::vector<Real> free);

/// Between the nodes of a level of bricks and those of one with half as many along each axis: every second one, and at
/// the upper faces the last one, where bricks of an odd number end. Linear in each coarser brick.
class Halving {
 public:
  Halving(Communicator const& comm, std::shared_ptr<Level const> fine);

  std::shared_ptr<Level const> const& coarse() const { return coarse_; }

  /// P' A P, fixed where what coincides is. Collective.
  NodeBlocks galerkin(NodeBlocks const& a) const;
  /// Add what is linear between coarser nodes; the transpose, which sets them. Collective.
  void add(int components, Real const* coarse, Real* fine) const;
  void transposed(int components, Real const* fine, Real* coarse) const;

 private:
  /// Call f(own node, its place) for a part's own nodes.
  template <class F>
  void for_each_own(std::size_t part, F&& f) const;
  std::vector<Real> at_coarse(int components, std::vector<Real> const& fine) const;

  Communicator comm_;
  std::shared_ptr<Level const> fine_, coarse_;
  BoxRegions parents_;  ///< of the nodes of finer boxes
};

/// Products with such rows in single precision, for smoothers.
class BlockRows {
 public:
  BlockRows(Communicator const& comm, NodeBlocks blocks);

  /// v = A u. Collective.
  void apply(Real const* u, Real* v) const;
  std::vector<Real> const& diagonal() const { return diagonal_; }
  std::size_t unknowns() const { return diagonal_.size(); }

 private:
  template <int C>
  void apply_as(Real const* u, Real* v) const;
  /// Call f(plane across z, box grown by one, place of the plane's first node in that, groups of lanes from there to
  /// its last one) for each plane of a box.
  template <class F>
  static void for_each_plane(Box const& box, F&& f);

  std::shared_ptr<Level const> nodes_;
  int components_;
  BoxRegions around_;  ///< own nodes and their neighbours
  /// Of each group of a plane its blocks' entries, one after the other: parts of the scale, so that none is too small.
  /// Nodes of a line are followed by two that are not own ones, whose entries are zeros.
  std::vector<float, BlockAllocator<float>> by_group_;
  Real scale_;
  std::vector<Real> diagonal_;
};

}  // namespace amrpic::fem
