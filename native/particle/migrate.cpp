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

bool Migration::start(ParticleView const& out) {
  arrivals_.start(mesh_.hierarchy().comm(), leaving_);
  places_ = sort(mesh_, destinations_, arrivals_.portions());
  bool const stayed = copy(mesh_, particles_, destinations_, places_, out);
  put_into_middles(out);
  return destinations_.finite && stayed && leaving_.finite;
}

/// Of bricks, so that places ascend with bricks for those under way too.
void Migration::put_into_middles(ParticleView const& out) const {
  for (std::size_t n = 0; n < places_.arrivals.size(); ++n) {
    Portion const& portion = arrivals_.portions()[n];
    Box const cells = cells_of(mesh_.hierarchy(), portion.home);
    LevelCoordinates const at = mesh_.locator().coordinates(portion.home.level);
    for (int d = 0; d < 3; ++d)
      std::fill_n(out.position[d] + places_.arrivals[n], portion.count,
                  at.lower[d] + 0.5 * Real(cells.lower[d] + cells.upper[d] + 1) / at.cells_per_metre[d]);
  }
}

std::vector<PlaceRange> Migration::under_way() const {
  std::vector<PlaceRange> out;
  for (std::size_t n = 0; n < places_.arrivals.size(); ++n)
    out.push_back({places_.arrivals[n], places_.arrivals[n] + arrivals_.portions()[n].count});
  return out;
}

void Migration::receive(ParticleView const& out) { arrivals_.receive(places_.arrivals, out); }

std::vector<int> Migration::first_servers() const {
  return amrpic::first_servers(mesh_.hierarchy(), servers_, places_.remote);
}

void Migration::carry(std::vector<Real const*> const& from, std::vector<Real*> const& to) const {
  std::vector<Real> left, arrived;
  for (auto const& to_rank : destinations_.leavers)
    for (auto const& leaver : to_rank)
      for (Real const* column : from) left.push_back(column[leaver.place]);
  exchange_rows(mesh_.hierarchy().comm(), from.size(), leaving_, left, arrivals_, arrived);
  copy_columns(from, to, particles_.count, destinations_, places_, arrivals_.portions(), arrived);
}

}  // namespace amrpic
