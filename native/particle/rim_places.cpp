#include "particle/rim_places.hpp"

#include <algorithm>

#include "particle/particle_mesh.hpp"

namespace amrpic {

namespace {

/// Places among all cells of a level and the ghosts of a plan, as places among its rims and the same ghosts; negative
/// ones stand for no cell and stay.
struct ToRim {
  Rim const& rim;
  LocalIndex owned;
  mutable std::size_t box = 0;  ///< that held the latest place

  LocalIndex operator()(LocalIndex place) const {
    if (place < 0) return place;
    return place < owned ? rim.number(place, box) : rim.cells() + (place - owned);
  }
  std::vector<LocalIndex> operator()(std::vector<LocalIndex> const& places) const {
    std::vector<LocalIndex> out;
    out.reserve(places.size());
    for (LocalIndex place : places) out.push_back((*this)(place));
    return out;
  }
  Exchange operator()(Exchange const& exchange) const { return exchange.kept_elsewhere(rim.cells(), *this); }
};

}  // namespace

RimPlaces::RimPlaces(ParticleMesh const& mesh, BufferZone const* zone) {
  Hierarchy const& hierarchy = mesh.hierarchy();
  std::vector<Rim> rims;
  for (int l = 0; l < hierarchy.level_count(); ++l)
    rims.emplace_back(hierarchy.level(l), hierarchy.has_finer(l) ? &hierarchy.level(l + 1) : nullptr);
  auto const to_rim = [&](int l) { return ToRim{rims[std::size_t(l)], hierarchy.level(l).local_cells()}; };
  for (int l = 0; l < hierarchy.level_count(); ++l) exchanges_.push_back(to_rim(l)(mesh.exchange(l)));
  for (BoxGhosts const& at : mesh.boxes()) {
    Box const& box = hierarchy.level(at.level).box(at.box);
    Shell shell = at.shell.kept_elsewhere(box, rims[std::size_t(at.level)].cells(), to_rim(at.level));
    around_.push_back({std::move(shell), to_rim(std::max(0, at.level - 1))(at.coarse), {}});
  }
  if (!zone) return;
  for (int l = 0; l < hierarchy.level_count(); ++l) of_matched_.push_back(to_rim(l)(zone->exchange(l)));
  for (std::size_t s = 0; s < around_.size(); ++s)
    if (BoxBuffer const* const buffer = zone->box(s))
      for (CoarseCells const& c : buffer->coarse) around_[s].matched.push_back(to_rim(c.level)(c.place));
}

}  // namespace amrpic
