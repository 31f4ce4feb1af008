#include "particle/migrate.hpp"

#include <algorithm>
#include <numeric>

#include "particle/copy.hpp"
#include "particle/remote_bricks.hpp"

namespace amrpic {

Migration::Migration(ParticleMesh& mesh, Servers servers, ParticleView const& particles, ParticleList const& gone,
                     bool has_weights)
    : mesh_(mesh), servers_(std::move(servers)), particles_(particles), destinations_(mesh) {
  Communicator const& comm = mesh.hierarchy().comm();
  destinations_ = classify(mesh, servers_, particles, gone);
  auto const& staying = destinations_.per_brick;
  staying_ = std::accumulate(staying.begin(), staying.end(), std::int64_t(0));
  leaving_ = pack(mesh, particles, destinations_.leavers, has_weights);
  arrivals_ = announce(comm, leaving_);
}

std::int64_t Migration::bricks() const {
  auto const& staying = destinations_.per_brick;
  return std::count_if(staying.begin(), staying.end(), [](std::int64_t count) { return count > 0; });
}

bool Migration::finish(ParticleView const& out) {
  exchange(mesh_.hierarchy().comm(), leaving_, arrivals_);
  places_ = sort(mesh_, destinations_, arrivals_);
  bool const stayed = copy(mesh_, particles_, destinations_, arrivals_, places_, out);
  return destinations_.finite && stayed && leaving_.finite;
}

std::vector<int> Migration::first_servers() const {
  return amrpic::first_servers(mesh_.hierarchy(), servers_, places_.remote);
}

void Migration::carry(std::vector<Real const*> const& from, std::vector<Real*> const& to) const {
  std::vector<Real> left, arrived;
  for (auto const& to_rank : destinations_.leavers)
    for (auto const& [n, home] : to_rank)
      for (Real const* column : from) left.push_back(column[n]);
  exchange_rows(mesh_.hierarchy().comm(), from.size(), leaving_, left, arrivals_, arrived);
  copy_columns(from, to, particles_.count, destinations_, places_, arrived);
}

}  // namespace amrpic
