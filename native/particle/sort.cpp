#include "particle/sort.hpp"

#include <limits>
#include <numeric>
#include <utility>

namespace amrpic {

namespace {

LocalIndex brick_of(ParticleMesh const& mesh, Home const& home) {
  return mesh.first_brick(mesh.slot(home.level, home.box)) + home.brick;
}

}  // namespace

Places sort(ParticleMesh const& mesh, Destinations const& destinations, PackedParticles const& arrivals) {
  std::vector<std::int64_t> next = destinations.per_brick;  // place of each brick; at first how many it will hold
  for (PackedParticle const& particle : arrivals.all) ++next[std::size_t(brick_of(mesh, particle.home))];
  next.push_back(0);
  std::exclusive_scan(next.begin(), next.end(), next.begin(), std::int64_t(0));
  auto const take = [&](LocalIndex brick, LocalIndex count = 1) {
    return LocalIndex(std::exchange(next[std::size_t(brick)], next[std::size_t(brick)] + count));
  };

  Places out;
  for (std::size_t s = 0; s <= mesh.boxes().size(); ++s)
    out.slots.push_back(next[std::size_t(mesh.first_brick(int(s)))]);
  out.runs.reserve(destinations.runs.size());
  out.movers.reserve(destinations.movers.size());
  out.wrapped.reserve(destinations.wrapped.size());
  out.arrivals.resize(arrivals.all.size());

  std::int64_t const first_higher = arrivals.starts[std::size_t(mesh.hierarchy().comm().rank())];
  auto const place_arrivals = [&](std::int64_t first, std::int64_t last, bool wrapped) {
    for (std::int64_t n = first; n < last; ++n)
      if (PackedParticle const& particle = arrivals.all[std::size_t(n)]; particle.wrapped == wrapped)
        out.arrivals[std::size_t(n)] = take(brick_of(mesh, particle.home));
  };
  auto mover = destinations.movers.begin();
  auto const place_movers_before = [&](LocalIndex place) {
    for (; mover != destinations.movers.end() && mover->place < place; ++mover)
      out.movers.push_back({mover->place, take(mover->brick)});
  };

  place_arrivals(0, first_higher, false);
  for (auto const& run : destinations.runs) {
    place_movers_before(run.first);  // none of those within the run goes to the brick of its stayers
    out.runs.push_back(take(run.brick, run.stayed));
  }
  place_movers_before(std::numeric_limits<LocalIndex>::max());
  place_arrivals(first_higher, arrivals.count(), false);

  place_arrivals(0, first_higher, true);
  for (auto const& [place, brick] : destinations.wrapped) out.wrapped.push_back({place, take(brick)});
  place_arrivals(first_higher, arrivals.count(), true);
  return out;
}

}  // namespace amrpic
