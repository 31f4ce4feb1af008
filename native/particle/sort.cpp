#include "particle/sort.hpp"

#include <algorithm>
#include <limits>
#include <numeric>
#include <utility>

namespace amrpic {

namespace {

/// Numbers of remote bricks in ascending order of these.
std::vector<LocalIndex> in_order(BrickNumbers const& bricks, LocalIndex own) {
  std::vector<Home> const& remote = bricks.remote();
  std::vector<LocalIndex> out(remote.size());
  std::iota(out.begin(), out.end(), own);
  std::sort(out.begin(), out.end(),
            [&](LocalIndex a, LocalIndex b) { return remote[std::size_t(a - own)] < remote[std::size_t(b - own)]; });
  return out;
}

}  // namespace

Places sort(ParticleMesh const& mesh, Destinations& destinations, std::vector<Portion> const& arrivals) {
  BrickNumbers& bricks = destinations.bricks;
  std::vector<LocalIndex> brick_of;  // of each portion
  for (Portion const& portion : arrivals) brick_of.push_back(bricks.number(portion.home));
  LocalIndex const own = mesh.bricks();
  std::vector<std::int64_t> next = destinations.per_brick;  // place of each brick; at first how many it will hold
  next.resize(std::size_t(own) + bricks.remote().size(), 0);
  for (std::size_t n = 0; n < brick_of.size(); ++n) next[std::size_t(brick_of[n])] += arrivals[n].count;

  Places out;
  std::int64_t all = 0;
  for (LocalIndex brick = 0; brick < own; ++brick) all += std::exchange(next[std::size_t(brick)], all);
  for (std::size_t s = 0; s < mesh.boxes().size(); ++s)
    out.slots.push_back(next[std::size_t(mesh.first_brick(int(s)))]);
  for (LocalIndex brick : in_order(bricks, own)) {
    std::int64_t const count = std::exchange(next[std::size_t(brick)], all);
    if (count == 0) continue;
    out.slots.push_back(all);
    out.remote.push_back(bricks.remote()[std::size_t(brick - own)]);
    all += count;
  }
  out.slots.push_back(all);
  auto const take = [&](LocalIndex brick, LocalIndex count = 1) {
    return LocalIndex(std::exchange(next[std::size_t(brick)], next[std::size_t(brick)] + count));
  };

  out.runs.reserve(destinations.runs.size());
  out.movers.reserve(destinations.movers.size());
  out.wrapped.reserve(destinations.wrapped.size());
  out.arrivals.resize(brick_of.size());

  int const rank = mesh.hierarchy().comm().rank();
  auto const place_arrivals = [&](bool of_lower_ranks, bool wrapped) {
    for (std::size_t n = 0; n < arrivals.size(); ++n)
      if ((arrivals[n].rank < rank) == of_lower_ranks && arrivals[n].wrapped == wrapped)
        out.arrivals[n] = take(brick_of[n], LocalIndex(arrivals[n].count));
  };
  auto mover = destinations.movers.begin();
  auto const place_movers_before = [&](LocalIndex place) {
    for (; mover != destinations.movers.end() && mover->place < place; ++mover)
      out.movers.push_back({mover->place, take(mover->brick)});
  };

  place_arrivals(true, false);
  for (auto const& run : destinations.runs) {
    place_movers_before(run.first);  // none of those within the run goes to the brick of its stayers
    out.runs.push_back(take(run.brick, run.stayed));
  }
  place_movers_before(std::numeric_limits<LocalIndex>::max());
  place_arrivals(false, false);

  place_arrivals(true, true);
  for (auto const& [place, brick] : destinations.wrapped) out.wrapped.push_back({place, take(brick)});
  place_arrivals(false, true);
  return out;
}

}  // namespace amrpic
