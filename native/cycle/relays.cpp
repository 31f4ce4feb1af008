#include "cycle/relays.hpp"

#include <algorithm>
#include <cmath>

namespace amrpic::cycle {

namespace {

std::map<int, int> relays_to(std::vector<CopiedRectangle> const& asked, int most_direct) {
  std::map<int, std::int64_t> values;
  for (CopiedRectangle const& r : asked) values[r.rank] += r.cells.cells();
  return relays_of(values, most_direct);
}

void sort_by_rank(std::vector<RelayPlan::Step>& steps) {
  std::stable_sort(steps.begin(), steps.end(), [](auto const& a, auto const& b) { return a.rank < b.rank; });
}

}  // namespace

std::map<int, int> relays_of(std::map<int, std::int64_t> const& values, int most_direct) {
  std::map<int, int> out;
  for (auto const& [rank, number] : values) out[rank] = rank;
  if (int(values.size()) <= most_direct) return out;
  std::vector<std::pair<std::int64_t, int>> by_values;
  for (auto const& [rank, number] : values) by_values.emplace_back(-number, rank);
  std::sort(by_values.begin(), by_values.end());
  std::size_t const relays = std::size_t(std::sqrt(double(values.size())));
  std::vector<int> passing, others;  // both in ascending order, so that readers of a relay are near each other
  for (std::size_t n = 0; n < by_values.size(); ++n) (n < relays ? passing : others).push_back(by_values[n].second);
  std::sort(passing.begin(), passing.end());
  std::sort(others.begin(), others.end());
  for (std::size_t n = 0; n < others.size(); ++n) out[others[n]] = passing[n * relays / others.size()];
  return out;
}

RoutedReads::RoutedReads(std::vector<CopiedRectangle> of_all, int most_direct)
    : asked(std::move(of_all)), relays(relays_to(asked, most_direct)) {
  for (std::size_t n = 0; n < asked.size(); ++n) {
    of_reader[asked[n].rank].push_back(int(n));
    sent_first[relays.at(asked[n].rank)].push_back(int(n));
  }
}

RelayPlan plan_relays(int me, CopiesAcrossRanks const& across, Routes const& routes) {
  RelayPlan out;
  auto const from_me = relays_to(across.asked, routes.most_direct);
  for (std::size_t n = 0; n < across.asked.size(); ++n)
    out.sent_first.push_back({from_me.at(across.asked[n].rank), int(n), -1});
  sort_by_rank(out.sent_first);
  for (std::size_t first = 0; first < across.wanted.size();) {
    int const owner = across.wanted[first].rank;
    int number = int(first);
    while (first < across.wanted.size() && across.wanted[first].rank == owner) ++first;
    auto const of_owner = routes.of(owner);
    if (int const relay = of_owner->relays.at(me); relay != me) {
      for (std::size_t n = 0; n < of_owner->of_reader.at(me).size(); ++n)
        out.received_second.push_back({relay, number++, -1});
      continue;
    }
    for (int n : of_owner->sent_first.at(me)) {
      CopiedRectangle const& r = of_owner->asked[std::size_t(n)];
      int const place = int(out.passed_on.size());
      out.received_first.push_back({owner, r.rank == me ? number++ : -1, r.rank == me ? -1 : place});
      if (r.rank == me) continue;
      out.passed_on.push_back(r.cells);
      out.sent_second.push_back({r.rank, -1, place});
    }
  }
  for (auto* steps : {&out.received_first, &out.sent_second, &out.received_second}) sort_by_rank(*steps);
  return out;
}

}  // namespace amrpic::cycle
