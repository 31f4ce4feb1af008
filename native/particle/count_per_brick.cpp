#include "particle/count_per_brick.hpp"

#include <algorithm>
#include <map>
#include <utility>

#include "particle/classify.hpp"
#include "particle/home_box.hpp"
#include "particle/lane_groups.hpp"
#include "particle/servers.hpp"

namespace amrpic {

namespace {

/// A box in which particles were found.
struct CountedBox {
  HomeBox home;
  std::vector<std::int64_t> counts;  ///< of its bricks
};

}  // namespace

std::vector<BrickCount> count_per_brick(Locator& locator, std::array<Real*, 3> const& position, std::int64_t count) {
  std::map<std::pair<int, int>, CountedBox> boxes;
  CountedBox* latest = nullptr;
  Home home;
  auto const count_one = [&](std::int64_t n) {
    Real3 x{position[0][n], position[1][n], position[2][n]};
    if (!is_finite(x) || !locator.wrap(x)) return;
    home = locator.find(x, home);
    auto at = boxes.find({home.level, home.box});
    if (at == boxes.end()) {
      HomeBox box(locator, home.level, home.box);
      std::vector<std::int64_t> none(std::size_t(box.bricks()), 0);
      at = boxes.emplace(std::pair(home.level, home.box), CountedBox{std::move(box), std::move(none)}).first;
    }
    latest = &at->second;
    ++latest->counts[std::size_t(home.brick)];
  };
  for (std::int64_t first = 0; first < count; first += lane_count) {
    int const here = int(std::min<std::int64_t>(lane_count, count - first));
    auto bricks = IndexLanes{} - 1;  // where they lie in the box of the last one, mostly
    if (latest && here == lane_count) {
      LaneGroup const group{first, all_lanes};
      bricks = latest->home.find({load(position[0], group), load(position[1], group), load(position[2], group)});
    }
    CountedBox* const box = latest;
    for (int i = 0; i < here; ++i)
      if (bricks[i] >= 0)
        ++box->counts[std::size_t(bricks[i])];
      else
        count_one(first + i);
  }

  BrickCurve const curve(locator.hierarchy().domain());
  std::vector<BrickCount> out;
  for (auto const& [where, box] : boxes) {
    auto const [level, number] = where;
    Bricks const bricks(locator.hierarchy().level(level).box(number));
    for (int b = 0; b < bricks.count(); ++b)
      if (std::int64_t const n = box.counts[std::size_t(b)]; n > 0)
        out.push_back({curve.place(level, bricks[b].lower), n});
  }
  std::sort(out.begin(), out.end(), [](BrickCount const& a, BrickCount const& b) { return a.place < b.place; });
  return out;
}

}  // namespace amrpic
