#include "particle/arrange.hpp"

#include <algorithm>
#include <stdexcept>

#include "particle/classify.hpp"
#include "particle/remote_bricks.hpp"
#include "particle/sort.hpp"

namespace amrpic {

Arrangement arrange(ParticleMesh& mesh, Servers const& servers, ParticleView const& particles) {
  Destinations destinations = classify(mesh, servers, particles, {nullptr, nullptr});
  auto const& leavers = destinations.leavers;
  bool const all_stay = std::all_of(leavers.begin(), leavers.end(), [](auto const& some) { return some.empty(); });
  if (!destinations.finite || !destinations.lost.empty() || !all_stay)
    throw std::invalid_argument("particles that are to be arranged must be with their servers");
  Places sorted = sort(mesh, destinations, {});

  Arrangement out{
      std::vector<LocalIndex>(std::size_t(particles.count)), std::move(sorted.slots), std::move(sorted.remote), {}};
  out.first_servers = first_servers(mesh.hierarchy(), servers, out.remote);
  for (std::size_t run = 0; run < destinations.runs.size(); ++run) {
    LocalIndex to = sorted.runs[run];
    for (LocalIndex n = destinations.runs[run].first; n < destinations.runs[run].last; ++n)
      if (destinations.stays[std::size_t(n / lane_count)] >> (n % lane_count) & 1) out.places[std::size_t(n)] = to++;
  }
  for (auto const* moves : {&sorted.movers, &sorted.wrapped})
    for (auto const& [from, to] : *moves) out.places[std::size_t(from)] = to;
  return out;
}

}  // namespace amrpic
