#include "particle/copy.hpp"

#include <algorithm>
#include <cstdint>

#include "base/fetch.hpp"
#include "particle/lane_groups.hpp"

namespace amrpic {

namespace {

/// Particles that are copied one column after the other: so many that memory is read in long rows, so few that a column
/// of them stays in the second-level cache for those that moved. A multiple of eight.
constexpr LocalIndex batch_size = 4096;

/// Values that are copied from place to place, one for each particle.
struct Column {
  Real const* from;
  Real* to;
  bool is_momentum, far;
};

/// Those of the particles [first, last) that stayed, from the place on where they are written.
struct Stayers {
  LocalIndex first, last, to;
};

using Move = Places::Move;

/// Columns of position come first. Ids are copied as numbers, since only the bytes count.
std::vector<Column> columns_of(ParticleView const& from, ParticleView const& to) {
  std::vector<Column> out;
  for (int d = 0; d < 3; ++d) out.push_back({from.position[d], to.position[d], false, false});
  for (int d = 0; d < 3 && to.momentum[0]; ++d) out.push_back({from.momentum[d], to.momentum[d], true, false});
  out.push_back({reinterpret_cast<Real const*>(from.id), reinterpret_cast<Real*>(to.id), false, false});
  if (!to.equal_weights) out.push_back({from.weight, to.weight, false, false});
  for (Column& column : out) column.far = are_far(to.count, column.to);
  return out;
}

/// Copy those of the values [first, last) whose bits are set; there are `count` values, and `first` is a multiple of
/// eight. Whole cache lines of `to` are written past the cache if they are `far`. False if values are to be checked and
/// one of those passed is not finite.
///
/// Those whose bits are set are first put side by side in a buffer, and leave it some lines later: a processor waits
/// where it reads what two stores wrote just before.
bool copy_chosen(Real const* from, LocalIndex first, LocalIndex last, std::int64_t count, std::uint8_t const* bits,
                 Real* to, bool far, bool check) {
  constexpr int buffered = 512;
  alignas(sizeof(Lanes)) Real buffer[buffered + lane_count];
  int waiting =
      int(reinterpret_cast<std::uintptr_t>(to) / sizeof(Real) % lane_count);  // at first, what lies before `to`
  unsigned lanes = all_lanes << waiting & all_lanes;                          // of the line that is next
  to -= waiting;
  auto const write_lines = [&] {
    int const whole = waiting / lane_count * lane_count;
    for (int n = 0; n < whole; n += lane_count, lanes = all_lanes)
      store(to + n, {0, lanes}, load<Lanes>(buffer + n), far);
    store(buffer, load<Lanes>(buffer + whole));
    to += whole;
    waiting -= whole;
  };
  Lanes zero{};  // nan as soon as a value is not finite
  for (LocalIndex n = first; n < last; n += lane_count, ++bits) {
    bring_near(from + n + page<Real>);
    Lanes const values = load_up_to(from + n, count - n);
    if (check) zero += values - values;
    waiting += compress(*bits, values, buffer + waiting);
    if (waiting >= buffered) write_lines();
  }
  write_lines();
  if (waiting > 0) store(to, {0, lanes & all_lanes >> (lane_count - waiting)}, load<Lanes>(buffer), far);
  return bits_of(zero == 0) == all_lanes;
}

/// Copy particles one by one. False if a momentum is not finite.
bool copy_moved(std::vector<Column> const& columns, Move const* first, Move const* last) {
  Real zero = 0;  // nan as soon as a momentum is not finite
  for (Column const& c : columns)
    for (Move const* m = first; m != last; ++m) {
      Real const value = c.to[m->to] = c.from[m->from];
      if (c.is_momentum) zero += value - value;
    }
  return zero == 0;
}

}  // namespace

bool copy(ParticleMesh const& mesh, ParticleView const& particles, Destinations const& destinations,
          Places const& places, ParticleView const& out) {
  std::vector<Column> const columns = columns_of(particles, out);
  std::uint8_t const* const stays = destinations.stays.data();
  LocalIndex const count = LocalIndex(particles.count);
  bool finite = true;

  std::vector<Stayers> stayers;  // of a batch, as are the movers
  std::size_t run = 0;
  LocalIndex to = 0;  // place of the run's next one that stayed
  Move const *mover = places.movers.data(), *const end_of_movers = mover + places.movers.size();
  for (LocalIndex first = 0; first < count; first += batch_size) {
    LocalIndex const last = std::min(count, first + batch_size);
    stayers.clear();
    for (; run < destinations.runs.size(); ++run) {
      auto const& whole = destinations.runs[run];
      LocalIndex const begin = std::max(first, whole.first), end = std::min(last, whole.last);
      if (begin >= end) break;
      if (begin == whole.first) to = places.runs[run];
      stayers.push_back({begin, end, to});
      for (LocalIndex n = begin; n < end; n += lane_count) to += __builtin_popcount(stays[n / lane_count]);
      if (whole.last > last) break;
    }
    Move const* const first_mover = mover;
    for (; mover != end_of_movers && mover->from < last; ++mover)
      for (Column const& c : columns) fetch<Use::write>(c.to + mover->to, 1);

    for (Column const& c : columns)
      for (Stayers const& some : stayers)
        finite &= copy_chosen(c.from, some.first, some.last, particles.count, stays + some.first / lane_count,
                              c.to + some.to, c.far, c.is_momentum);
    finite &= copy_moved(columns, first_mover, mover);
  }

  finite &= copy_moved(columns, places.wrapped.data(), places.wrapped.data() + places.wrapped.size());
  for (Move const& m : places.wrapped) {
    Real3 x = particles.at(m.from);
    mesh.locator().wrap(x);
    for (int d = 0; d < 3; ++d) out.position[d][m.to] = x[d];
  }
  stream_end();
  return finite;
}

void copy_columns(std::vector<Real const*> const& from, std::vector<Real*> const& to, std::int64_t count,
                  Destinations const& destinations, Places const& places, std::vector<Portion> const& arrivals,
                  std::vector<Real> const& arrived) {
  std::size_t const width = from.size();
  for (std::size_t c = 0; c < width; ++c) {
    bool const far = are_far(count, to[c]);
    for (std::size_t run = 0; run < destinations.runs.size(); ++run) {
      auto const& [brick, first, last, stayed] = destinations.runs[run];
      copy_chosen(from[c], first, last, count, destinations.stays.data() + first / lane_count, to[c] + places.runs[run],
                  far, false);
    }
    for (auto const* moves : {&places.movers, &places.wrapped})
      for (auto const& [old, place] : *moves) to[c][place] = from[c][old];
    Real const* in = arrived.data() + c;
    for (std::size_t n = 0; n < arrivals.size(); ++n)
      for (std::int64_t i = 0; i < arrivals[n].count; ++i, in += width) to[c][places.arrivals[n] + i] = *in;
  }
  stream_end();
}

}  // namespace amrpic
