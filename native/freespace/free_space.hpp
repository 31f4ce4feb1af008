// The potential of charges in free space by the 7-point operator: what an open wall needs.
#pragma once

#include <memory>
#include <vector>

#include "base/communicator.hpp"
#include "freespace/tree_potential.hpp"
#include "freespace/wall_plan.hpp"

namespace amrpic::freespace {

/// Potential phi of -Laplace phi = charge density on the infinite lattice: about q / (4 pi r), with 0 at infinity.
///
/// The charge of a mesh is joined to ever wider blocks up to a top that all ranks know. Each rank evaluates its share
/// of the patches of ghosts with what it sees of the tree, whoever owns the walls. Where the plan is `by_axes`, each
/// rank sums over all charge for its own walls.
class FreeSpace {
 public:
  FreeSpace(Communicator const& comm, Lattice const& lattice, bool has_images, Options const& options = {});
  Lattice const& lattice() const { return lattice_; }
  Options const& options() const { return options_; }
  /// Whether it serves a mesh with images or without, and such options.
  bool is_for(bool has_images, Options const& options) const {
    return has_images == has_images_ && options.acceptance == options_.acceptance &&
           options.lattice_limit == options_.lattice_limit;
  }

  /// Who does what on a mesh of this lattice. Local.
  std::shared_ptr<WallPlan const> plan(WallMesh const& mesh) const;

  /// Potential at the ghost centres behind this rank's open walls, on all levels: see `WallPlan::place`. `local`: the
  /// boxes of this rank, level by level. Results do not depend on the ranks. Collective: a few small reductions, else
  /// messages between the ranks of the plan.
  std::vector<double> walls(WallPlan const& plan, std::vector<ChargeBox> const& local, Which which = Which::all);

 private:
  std::vector<double> all_charges(WallPlan const& plan, std::vector<ChargeBox> const& local) const;
  ChargeBlocks own_charges(WallPlan const& plan, std::vector<ChargeBox> local) const;
  OctreeBuilder leaves_of(WallPlan const& plan, ChargeBlocks const& blocks);
  void join_upwards(WallPlan const& plan, OctreeBuilder& builder) const;
  std::vector<NodeRecord> known_on_all(WallGeometry const& geometry, OctreeBuilder const& builder) const;
  std::vector<NodeRecord> united(std::vector<Block> const& blocks, std::vector<NodeRecord> const& own) const;
  std::vector<NodeRecord> children_of_others(WallPlan const& plan, OctreeBuilder const& builder) const;
  std::vector<LeafRecord> leaves_of_others(WallPlan const& plan, OctreeBuilder const& builder,
                                           ChargeBlocks const& blocks) const;
  void interpolate_down(WallPlan const& plan, std::vector<double>& values) const;
  std::vector<double> at_own_walls(WallPlan const& plan, std::vector<double> const& values) const;

  Communicator comm_;
  Lattice lattice_;
  bool has_images_;
  Options options_;
  std::unique_ptr<TreePotential const> evaluate_;
};

}  // namespace amrpic::freespace
