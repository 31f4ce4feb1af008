// The particles of one cell in order of their ids.
#pragma once

#include <algorithm>
#include <limits>
#include <utility>
#include <vector>

#include "particle/lanes.hpp"

namespace amrpic {

/// Ids, and something that goes with each.
struct Keyed {
  std::int64_t* id;
  LocalIndex* value;
};

/// `sort_by_id` reads whatever lies so far behind the last one.
constexpr LocalIndex sort_slack = lane_count;

/// Two: most of the cells with more than one particle, where few have any.
inline void sort_two_by_id(Keyed const& at) {
  bool const swap = at.id[1] < at.id[0];
  std::int64_t const id[] = {at.id[0], at.id[1]};
  LocalIndex const value[] = {at.value[0], at.value[1]};
  at.id[0] = id[swap], at.id[1] = id[!swap];
  at.value[0] = value[swap], at.value[1] = value[!swap];
}

/// At most as many as there are lanes: each one's place is the number of those that come before it. No branch depends
/// on the ids, so that none is mispredicted.
inline void sort_few_by_id(Keyed const& at, LocalIndex count) {
  WideLanes const behind = std::numeric_limits<std::int64_t>::max() - 1 + WideLanes{};
  WideLanes const id = lane_number < count ? load<WideLanes>(at.id) : behind;
  std::int64_t key[lane_count], place[lane_count];
  LocalIndex value[lane_count];
  store(key, id);
  store(value, load<IndexLanes>(at.value));
  WideLanes before{};
#pragma GCC unroll 8
  for (int j = 0; j < lane_count; ++j) before -= key[j] < id - (lane_number > j);  // of equal ids the first one
  store(place, before);
  for (int i = 0; i < count; ++i) at.id[place[i]] = key[i], at.value[place[i]] = value[i];
}

inline void sort_many_by_id(Keyed const& at, LocalIndex count) {
  if (std::is_sorted(at.id, at.id + count)) return;  // as they are where nobody came or went
  thread_local std::vector<std::pair<std::int64_t, LocalIndex>> pairs;
  pairs.resize(std::size_t(count));
  for (LocalIndex i = 0; i < count; ++i) pairs[i] = {at.id[i], at.value[i]};
  std::stable_sort(pairs.begin(), pairs.end(), [](auto const& a, auto const& b) { return a.first < b.first; });
  for (LocalIndex i = 0; i < count; ++i) at.id[i] = pairs[i].first, at.value[i] = pairs[i].second;
}

/// Put `count` particles in order of their ids; equal ids keep their order.
inline void sort_by_id(Keyed const& at, LocalIndex count) {
  if (count == 2)
    sort_two_by_id(at);
  else if (count <= lane_count)
    sort_few_by_id(at, count);
  else
    sort_many_by_id(at, count);
}

}  // namespace amrpic
