#include "particle/callers_columns.hpp"

#include <algorithm>
#include <limits>

#include "particle/lane_groups.hpp"

namespace amrpic {

namespace {

constexpr std::int64_t batch_size = 4096;  ///< values that are added up by themselves, so that rounding stays small

/// Sums and bounds of values, eight at a time.
struct Tally {
  Lanes sum{}, magnitude{};
  Lanes least = Lanes{} + std::numeric_limits<Real>::infinity();
  Lanes greatest = Lanes{} - std::numeric_limits<Real>::infinity();

  void add(Lanes const& v) {
    sum += v;
    magnitude += select(v < Lanes{}, 0 - v, v);
    least = select(v < least, v, least);
    greatest = select(v > greatest, v, greatest);
  }

  void add_to(ColumnSums& all) const {
    Real own = 0, size = 0;
    for (int i = 0; i < lane_count; ++i) {
      own += sum[i], size += magnitude[i];
      all.least = std::min(all.least, least[i]), all.greatest = std::max(all.greatest, greatest[i]);
    }
    all.sum += own, all.magnitude += size;
  }
};

template <class Value>
ColumnSums taken(Value const& value, std::int64_t count, Real shift, Real scale, Real* out) {
  constexpr Real infinity = std::numeric_limits<Real>::infinity();
  ColumnSums all{0, 0, infinity, -infinity};
  for (std::int64_t begin = 0; begin < count; begin += batch_size) {
    std::int64_t const end = std::min(count, begin + batch_size);
    Tally tally;
    std::int64_t n = begin;
    for (; n + lane_count <= end; n += lane_count) {
      Lanes const v{value(n),     value(n + 1), value(n + 2), value(n + 3),
                    value(n + 4), value(n + 5), value(n + 6), value(n + 7)};
      tally.add(v);
      if (out) store(out + n, (v - shift) * scale);
    }
    tally.add_to(all);
    for (; n < end; ++n) {
      Real const v = value(n);
      all.sum += v, all.magnitude += std::abs(v);
      all.least = std::min(all.least, v), all.greatest = std::max(all.greatest, v);
      if (out) out[n] = (v - shift) * scale;
    }
  }
  return all;
}

}  // namespace

ColumnSums take_column(StridedColumn const& from, std::int64_t const* places, std::int64_t count, Real shift,
                       Real scale, Real* out) {
  if (places) return taken([&](std::int64_t n) { return from[places[n]]; }, count, shift, scale, out);
  if (from.stride == 1) return taken([&](std::int64_t n) { return from.first[n]; }, count, shift, scale, out);
  return taken([&](std::int64_t n) { return from[n]; }, count, shift, scale, out);
}

void put_into_places(std::array<Real*, 3> const& values, CallersPlaces const& to, std::array<Real*, 3> const& out) {
  for (std::size_t d = 0; d < 3; ++d)
    for (std::int64_t n = 0; n < to.count; ++n) out[d][to.places[n]] = values[d][n] * to.factors[d];
}

}  // namespace amrpic
