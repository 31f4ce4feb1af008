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
  Keyed from(std::ptrdiff_t n) const { return {id + n, value + n}; }
};

/// `sort_by_id` reads whatever lies so far behind the last one, and writes it behind the last one.
constexpr LocalIndex sort_slack = lane_count;

/// At most as many as there are lanes: each one's place is the number of those that come before it. No branch depends
/// on the ids, so that none is mispredicted.
inline void sort_few_by_id(Keyed const& in, LocalIndex count, Keyed const& out) {
  WideLanes const behind = std::numeric_limits<std::int64_t>::max() - 1 + WideLanes{};
  WideLanes const id = lane_number < count ? load<WideLanes>(in.id) : behind;
  std::int64_t key[lane_count], place[lane_count];
  store(key, id);
  WideLanes before{};
#pragma GCC unroll 8
  for (int j = 0; j < lane_count; ++j) before -= key[j] < id - (lane_number > j);  // of equal ids the first one
  store(place, before);
#pragma GCC unroll 8
  for (int i = 0; i < lane_count; ++i) out.id[place[i]] = in.id[i], out.value[place[i]] = in.value[i];
}

inline void sort_many_by_id(Keyed const& in, LocalIndex count, Keyed const& out) {
  thread_local std::vector<std::pair<std::int64_t, LocalIndex>> pairs;
  pairs.resize(std::size_t(count));
  for (LocalIndex i = 0; i < count; ++i) pairs[i] = {in.id[i], in.value[i]};
  std::stable_sort(pairs.begin(), pairs.end(), [](auto const& a, auto const& b) { return a.first < b.first; });
  for (LocalIndex i = 0; i < count; ++i) out.id[i] = pairs[i].first, out.value[i] = pairs[i].second;
}

/// Write `count` particles in order of their ids; equal ids keep their order. What follows them is written as it is.
inline void sort_by_id(Keyed const& in, LocalIndex count, Keyed const& out) {
  if (count <= lane_count)
    sort_few_by_id(in, count, out);
  else
    sort_many_by_id(in, count, out);
}

}  // namespace amrpic
