#include "mesh/cluster.hpp"

#include <algorithm>
#include <array>
#include <cstdlib>
#include <optional>

#include "mesh/box_set.hpp"

namespace amrpic {

namespace {

using Blocks = std::vector<Index3>;
using Part = std::array<Blocks::iterator, 2>;
using Signature = std::vector<std::int64_t>;  ///< number of blocks in each plane normal to an axis

/// The plane that becomes the first one of the upper half, counted from the lower end of the box.
struct Cut {
  int axis;
  int at;
};

Box bounding_box(Part const& part) {
  Box box{*part[0], *part[0]};
  std::for_each(part[0], part[1], [&](Index3 const& block) {
    for (int d = 0; d < 3; ++d) {
      box.lower[d] = std::min(box.lower[d], block[d]);
      box.upper[d] = std::max(box.upper[d], block[d]);
    }
  });
  return box;
}

std::array<Signature, 3> signatures(Part const& part, Box const& box) {
  std::array<Signature, 3> out;
  for (int d = 0; d < 3; ++d) out[d].assign(std::size_t(box.extent(d)), 0);
  std::for_each(part[0], part[1], [&](Index3 const& block) {
    for (int d = 0; d < 3; ++d) ++out[d][std::size_t(block[d] - box.lower[d])];
  });
  return out;
}

std::array<int, 3> longest_first(Box const& box) {
  std::array<int, 3> axes{0, 1, 2};
  std::stable_sort(axes.begin(), axes.end(), [&](int a, int b) { return box.extent(a) > box.extent(b); });
  return axes;
}

/// Distance of a cut from the middle, in half planes.
int off_centre(int at, std::size_t planes) { return std::abs(2 * at - int(planes)); }

/// The empty plane nearest to the middle of the longest axis that has one.
std::optional<Cut> at_hole(std::array<Signature, 3> const& counts, std::array<int, 3> const& axes) {
  for (int axis : axes) {
    auto const& count = counts[axis];
    std::optional<Cut> best;
    for (int i = 1; i + 1 < int(count.size()); ++i)
      if (count[i] == 0 && (!best || off_centre(i, count.size()) < off_centre(best->at, count.size())))
        best = Cut{axis, i};
    if (best) return best;
  }
  return std::nullopt;
}

/// The strongest change of sign of the signatures' second difference; of equals the one nearest to the middle.
std::optional<Cut> at_inflection(std::array<Signature, 3> const& counts, std::array<int, 3> const& axes) {
  std::optional<Cut> best;
  std::int64_t strongest = 0;
  int nearest = 0;
  for (int axis : axes) {
    auto const& count = counts[axis];
    int const n = int(count.size());
    auto at = [&](int i) { return i < 0 || i >= n ? 0 : count[i]; };  // outside the box nothing is tagged
    auto second_difference = [&](int i) { return at(i - 1) - 2 * at(i) + at(i + 1); };
    for (int i = 1; i < n; ++i) {
      std::int64_t const before = second_difference(i - 1), after = second_difference(i);
      if (!((before < 0 && after > 0) || (before > 0 && after < 0))) continue;
      std::int64_t const strength = std::abs(after - before);
      int const distance = off_centre(i, count.size());
      if (strength < strongest || (strength == strongest && distance >= nearest)) continue;
      best = Cut{axis, i}, strongest = strength, nearest = distance;
    }
  }
  return best;
}

Cut choose_cut(Part const& part, Box const& box) {
  auto const counts = signatures(part, box);
  auto const axes = longest_first(box);
  if (auto const cut = at_hole(counts, axes)) return *cut;
  if (auto const cut = at_inflection(counts, axes)) return *cut;
  return {axes[0], box.extent(axes[0]) / 2};
}

}  // namespace

std::vector<Box> cluster(std::vector<Index3> blocks, Real efficiency) {
  std::sort(blocks.begin(), blocks.end());
  blocks.erase(std::unique(blocks.begin(), blocks.end()), blocks.end());

  std::vector<Box> boxes;
  std::vector<Part> pending;
  if (!blocks.empty()) pending.push_back({blocks.begin(), blocks.end()});
  while (!pending.empty()) {
    Part const part = pending.back();
    pending.pop_back();
    Box const box = bounding_box(part);
    if (Real(part[1] - part[0]) >= efficiency * Real(box.cells())) {
      boxes.push_back(box);
      continue;
    }
    // The box fits tightly, so both halves hold blocks and the recursion ends, at single blocks at the latest.
    Cut const cut = choose_cut(part, box);
    auto const middle = std::partition(
        part[0], part[1], [&](Index3 const& block) { return block[cut.axis] < box.lower[cut.axis] + cut.at; });
    pending.push_back({part[0], middle});
    pending.push_back({middle, part[1]});
  }
  return joined(std::move(boxes));  // their union is no emptier than the emptiest of them
}

}  // namespace amrpic
