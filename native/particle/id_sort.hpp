// Particles in order of their ids.
#pragma once

#include <algorithm>
#include <cstdint>
#include <utility>
#include <vector>

#include "particle/lanes.hpp"

namespace amrpic {

/// Ids, and something that goes with each.
struct Keyed {
  std::int64_t* id;
  LocalIndex* value;
};

/// So many are sorted faster by comparing each with each.
constexpr LocalIndex few = 192;

/// Each one's place is the number of those that come before it. No branch depends on the ids, so that none is
/// mispredicted.
inline void sort_few_by_id(Keyed const& at, LocalIndex count) {
  alignas(64) std::int64_t id[few], place[few];
  LocalIndex value[few];
  std::copy(at.id, at.id + count, id);
  std::copy(at.value, at.value + count, value);
  for (LocalIndex i = 0; i < count; i += lane_count) {
    WideLanes const those = load<WideLanes>(id + i), or_equal = those + 1;
    WideLanes before{};
    LocalIndex const end = std::min(i + lane_count, count);
    for (LocalIndex j = 0; j < i; ++j) before -= id[j] < or_equal;  // of equal ids the first one
    for (LocalIndex j = i; j < end; ++j) before -= id[j] < those - (lane_number > j - i);
    for (LocalIndex j = end; j < count; ++j) before -= id[j] < those;
    store(place + i, before);
  }
  for (LocalIndex i = 0; i < count; ++i) at.id[place[i]] = id[i], at.value[place[i]] = value[i];
}

inline void sort_many_by_id(Keyed const& at, LocalIndex count) {
  thread_local std::vector<std::pair<std::int64_t, LocalIndex>> pairs;
  pairs.resize(std::size_t(count));
  for (LocalIndex i = 0; i < count; ++i) pairs[i] = {at.id[i], at.value[i]};
  std::stable_sort(pairs.begin(), pairs.end(), [](auto const& a, auto const& b) { return a.first < b.first; });
  for (LocalIndex i = 0; i < count; ++i) at.id[i] = pairs[i].first, at.value[i] = pairs[i].second;
}

/// Put `count` particles in order of their ids; equal ids keep their order.
inline void sort_by_id(Keyed const& at, LocalIndex count) {
  if (count <= few)
    sort_few_by_id(at, count);
  else
    sort_many_by_id(at, count);
}

inline bool are_in_order(std::int64_t const* ids, LocalIndex count) {
  WideLanes wrong{};
  LocalIndex i = 0;
  for (; i + lane_count < count; i += lane_count) wrong |= load<WideLanes>(ids + i) > load<WideLanes>(ids + i + 1);
  return bits_of(wrong) == 0 && std::is_sorted(ids + i, ids + count);
}

/// How many of `count` ascending ids are smaller. No branch depends on them.
inline LocalIndex count_smaller(std::int64_t const* ids, LocalIndex count, std::int64_t id) {
  std::int64_t const* from = ids;
  for (; count > 1; count -= count / 2) from += LocalIndex(from[count / 2 - 1] < id) * (count / 2);
  return LocalIndex(from - ids) + (count == 1 && *from < id);
}

}  // namespace amrpic
