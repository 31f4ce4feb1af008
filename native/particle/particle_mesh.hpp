#pragma once

#include <memory>
#include <vector>

#include "mesh/transfer.hpp"
#include "particle/boundary_places.hpp"
#include "particle/buffer_zone.hpp"
#include "particle/density_places.hpp"
#include "particle/ghost_plan.hpp"
#include "particle/home_box.hpp"
#include "particle/locate.hpp"

namespace amrpic {

/// What deposit and gather need of a hierarchy: which box holds a point, and where the ghost cells of this rank's boxes
/// are stored. It is made once per hierarchy.
class ParticleMesh {
 public:
  /// Collective.
  explicit ParticleMesh(std::shared_ptr<Hierarchy const> hierarchy);

  Hierarchy const& hierarchy() const { return *hierarchy_; }
  Locator& locator() { return locator_; }
  Locator const& locator() const { return locator_; }
  Halo const& halo(int level) const { return ghosts_.halos[std::size_t(level)]; }
  Transfer const& transfer() const { return transfer_; }

  /// Which particles are treated as matched at coarse-fine faces. Collective at the first call.
  BufferZone const& buffer_zone();

  /// Where the field in the boxes' ghost cells is stored; collective at the first call with matched clouds.
  BoundaryPlaces const& boundary_places(bool matched);

  /// Where the density that compensates clouds is stored around boxes; as above.
  DensityPlaces const& density_places(bool matched);

  /// This rank's boxes, level by level. Their numbers are called slots.
  std::vector<BoxGhosts> const& boxes() const { return ghosts_.boxes; }
  int slot(int level, int local_box) const {
    return first_slot_[level] + local_box - hierarchy_->level(level).first_local_box();
  }

  /// Those boxes as homes of particles, by slot.
  std::vector<HomeBox> const& homes() const { return homes_; }
  /// Their bricks are numbered too: where those of a slot start; of one slot more, how many bricks there are.
  LocalIndex first_brick(int slot) const { return first_brick_[std::size_t(slot)]; }
  LocalIndex bricks() const { return first_brick_.back(); }

 private:
  std::shared_ptr<Hierarchy const> hierarchy_;
  Locator locator_;
  Transfer transfer_;
  GhostPlan ghosts_;
  std::vector<int> first_slot_;
  std::vector<HomeBox> homes_;
  std::vector<LocalIndex> first_brick_{0};  ///< of each slot; then how many there are
  // null until first used
  std::unique_ptr<BufferZone const> buffer_zone_;
  std::unique_ptr<BoundaryPlaces const> without_matched_, with_matched_;
  std::unique_ptr<DensityPlaces const> densities_, densities_with_matched_;
};

}  // namespace amrpic
