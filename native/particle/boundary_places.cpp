#include "particle/boundary_places.hpp"

#include <algorithm>

#include "particle/particle_mesh.hpp"

namespace amrpic {

namespace {

/// Places among all cells of a level and the halo of a plan, as places among its boundary cells and the same halo;
/// negative ones stand for no cell and stay.
struct ToBoundary {
  BoundaryCells const& boundary;
  LocalIndex owned;
  mutable std::size_t box = 0;  ///< of the latest place

  LocalIndex operator()(LocalIndex place) const {
    if (place < 0) return place;
    return place < owned ? boundary.number(place, box) : boundary.cells() + (place - owned);
  }
  std::vector<LocalIndex> operator()(std::vector<LocalIndex> const& places) const {
    std::vector<LocalIndex> out;
    out.reserve(places.size());
    for (LocalIndex place : places) out.push_back((*this)(place));
    return out;
  }
  Halo operator()(Halo const& halo) const { return halo.kept_elsewhere(boundary.cells(), *this); }
};

}  // namespace

BoundaryPlaces::BoundaryPlaces(ParticleMesh const& mesh, BufferZone const* zone) {
  Hierarchy const& hierarchy = mesh.hierarchy();
  std::vector<BoundaryCells> boundaries;
  for (int l = 0; l < hierarchy.level_count(); ++l) boundaries.emplace_back(hierarchy.faces(l));
  auto const to_boundary = [&](int l) {
    return ToBoundary{boundaries[std::size_t(l)], hierarchy.level(l).local_cells()};
  };
  for (int l = 0; l < hierarchy.level_count(); ++l) halos_.push_back(to_boundary(l)(mesh.halo(l)));
  for (BoxGhosts const& at : mesh.boxes()) {
    Box const& box = hierarchy.level(at.level).box(at.box);
    GhostCells ghosts = at.ghosts.kept_elsewhere(box, boundaries[std::size_t(at.level)].cells(), to_boundary(at.level));
    ghosts_.push_back({std::move(ghosts), to_boundary(std::max(0, at.level - 1))(at.coarse), {}});
  }
  if (!zone) return;
  for (int l = 0; l < hierarchy.level_count(); ++l) of_matched_.push_back(to_boundary(l)(zone->halo(l)));
  for (std::size_t s = 0; s < ghosts_.size(); ++s)
    if (BoxBuffer const* const buffer = zone->box(s))
      for (CoarseCells const& c : buffer->coarse) ghosts_[s].matched.push_back(to_boundary(c.level)(c.place));
}

}  // namespace amrpic
