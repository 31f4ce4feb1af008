#include "particle/particle_mesh.hpp"

namespace amrpic {

ParticleMesh::ParticleMesh(std::shared_ptr<Hierarchy const> hierarchy)
    : hierarchy_(std::move(hierarchy)),
      locator_(hierarchy_),
      transfer_(hierarchy_),
      ghosts_(ghost_plan(*hierarchy_, tile_reach)) {
  int slot = 0;
  for (int l = 0; l < hierarchy_->level_count(); ++l) {
    first_slot_.push_back(slot);
    Level const& level = hierarchy_->level(l);
    for (int b = level.first_local_box(); b < level.last_local_box(); ++b, ++slot) {
      homes_.emplace_back(locator_, l, b);
      first_brick_.push_back(bricks() + homes_.back().bricks());
    }
  }
}

BufferZone const& ParticleMesh::buffer_zone() {
  if (!buffer_zone_) buffer_zone_ = std::make_unique<BufferZone const>(*hierarchy_);
  return *buffer_zone_;
}

BoundaryPlaces const& ParticleMesh::boundary_places(bool matched) {
  auto& places = matched ? with_matched_ : without_matched_;
  if (!places) places = std::make_unique<BoundaryPlaces const>(*this, matched ? &buffer_zone() : nullptr);
  return *places;
}

DensityPlaces const& ParticleMesh::density_places(bool matched) {
  auto& places = matched ? densities_with_matched_ : densities_;
  if (!places) places = std::make_unique<DensityPlaces const>(*hierarchy_, matched ? &buffer_zone() : nullptr);
  return *places;
}

}  // namespace amrpic
