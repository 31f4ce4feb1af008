#include "cycle/rectangle_exchange.hpp"

#include <map>

#include "mesh/box_set.hpp"

namespace amrpic::cycle {

namespace {

/// Call f(row of a, row of b, length) for the rows of two rectangles of equal extent; rows that follow each other
/// closely in both are one.
template <class F>
void for_each_row(Index3 const& extent, Placement const& a, Placement const& b, F&& f) {
  bool const close = a.pitch_y == extent[0] && b.pitch_y == extent[0];
  int const length = close ? extent[0] * extent[1] : extent[0], rows = close ? 1 : extent[1];
  for (int k = 0; k < extent[2]; ++k)
    for (int j = 0; j < rows; ++j) f(a.place(0, j, k), b.place(0, j, k), length);
}

/// The extent of a rectangle in a message that has room for every other cell along one axis.
Index3 halved(Index3 extent) {
  int const axis = extent[0] > 1 ? 0 : 1;
  extent[axis] = (extent[axis] + 1) / 2;
  return extent;
}

/// Call f(place in memory, place in the message) for the cells of a part of a rectangle that have the parity of those
/// that pass.
template <class F>
void for_each_of_colour(Index3 const& rectangle, int parity, Index3 const& extent, Index3 const& first,
                        Placement const& at, F&& f) {
  Index3 const room = halved(rectangle);
  int const step_y = rectangle[0] > 1 ? 1 : 2;
  for (int k = 0; k < extent[2]; ++k)
    for (int j = 0; j < extent[1]; ++j) {
      std::ptrdiff_t const row = std::ptrdiff_t(room[0]) * ((first[1] + j) / step_y + room[1] * (first[2] + k));
      std::ptrdiff_t const from = at.place(0, j, k);
      for (int i = (first[0] + first[1] + j + first[2] + k + parity) & 1; i < extent[0]; i += 2)
        f(from + i, row + (first[0] + i) / 2);
    }
}

Index3 extent_of(Box const& box) { return {box.extent(0), box.extent(1), box.extent(2)}; }

Placement dense(Index3 const& extent) { return {0, extent[0], std::ptrdiff_t(extent[0]) * extent[1]}; }

/// A placement that begins at another cell.
Placement from(Placement at, Index3 const& steps) {
  at.origin = at.place(steps[0], steps[1], steps[2]);
  return at;
}

Index3 steps(Index3 const& first, Index3 const& to) { return {to[0] - first[0], to[1] - first[1], to[2] - first[2]}; }

/// Cells whose copies lie in one rectangle of memory, which the copy of a cell of index zero would begin.
struct Region {
  Placement copy;
  std::vector<Box> boxes;
};

/// Copied cells by where their copies lie, in as few boxes as contain them.
std::vector<Region> regions_of(std::vector<Copied> const& copied) {
  std::vector<Region> out;
  std::map<std::array<std::ptrdiff_t, 3>, std::size_t> known;
  for (Copied const& c : copied) {
    Placement const copy = from(c.copy, {-c.cells.lower[0], -c.cells.lower[1], -c.cells.lower[2]});
    auto const [at, fresh] =
        known.emplace(std::array<std::ptrdiff_t, 3>{copy.origin, copy.pitch_y, copy.pitch_z}, out.size());
    if (fresh) out.push_back({copy, {}});
    out[at->second].boxes.push_back(c.cells);
  }
  for (Region& region : out) region.boxes = joined(std::move(region.boxes));
  return out;
}

void copy_row(float const* from, int length, float* to) { std::copy_n(from, length, to); }
void add_row(float const* from, int length, float* to) {
  for (int i = 0; i < length; ++i) to[i] += from[i];
}

}  // namespace

RectangleExchange::RectangleExchange(Communicator const& comm, Layout const& layout, std::vector<Copied> const& local,
                                     CopiesAcrossRanks const& across, ForEachPart const& copies, Colours colours,
                                     Routes const& routes)
    : colours_(colours) {
  auto own = [&](Box const& box, VisitPart const& f) { layout.for_each_own_part(box, f); };
  for (Region const& region : regions_of(local))
    for (Box const& box : region.boxes)
      own(box, [&](Box const& part, Placement const& at) {
        local_.push_back({extent_of(part), at, from(region.copy, part.lower)});
      });
  local_.shrink_to_fit();
  asked_ = packed(across.asked, false, own);
  wanted_ = packed(across.wanted, true, copies);
  if (routes.of && comm.ranks() - 1 > routes.most_direct)
    plan_with_relays(comm, across, routes);
  else
    exchange_ = Exchange<float>(comm, parcels(across.asked), parcels(across.wanted));
}

/// What passes in one direction.
std::vector<Parcel> RectangleExchange::parcels(std::vector<CopiedRectangle> const& rectangles) {
  std::vector<Parcel> out;
  for (CopiedRectangle const& r : rectangles) {
    neighbours_.insert(r.rank);
    out.push_back({r.rank, places(r.cells)});
  }
  return out;
}

void RectangleExchange::plan_with_relays(Communicator const& comm, CopiesAcrossRanks const& across,
                                         Routes const& routes) {
  relays_ = std::make_unique<Relays>();
  RelayPlan const& plan = relays_->plan = plan_relays(comm.rank(), across, routes);
  relays_->first.push_back(0);
  for (Box const& cells : plan.passed_on) relays_->first.push_back(relays_->first.back() + std::size_t(places(cells)));
  relays_->values.resize(relays_->first.back());
  auto const steps = [&](std::vector<RelayPlan::Step> const& of, std::vector<CopiedRectangle> const& own) {
    std::vector<CopiedRectangle> out;
    for (auto const& step : of)
      out.push_back({step.rank,
                     step.own < 0 ? plan.passed_on[std::size_t(step.passed_on)] : own[std::size_t(step.own)].cells,
                     {}});
    return parcels(out);
  };
  exchange_ = Exchange<float>(comm, steps(plan.sent_first, across.asked), steps(plan.received_first, across.wanted));
  relays_->second_round =
      Exchange<float>(comm, steps(plan.sent_second, {}), steps(plan.received_second, across.wanted));
}

/// How many values of a rectangle pass.
std::int64_t RectangleExchange::places(Box const& cells) const {
  if (colours_ == Colours::all) return cells.cells();
  Index3 const room = halved(extent_of(cells));
  return std::int64_t(room[0]) * room[1] * room[2];
}

/// Where the cells of each rectangle lie; `shifted`: as copies, else as they are owned.
RectangleExchange::Packed RectangleExchange::packed(std::vector<CopiedRectangle> const& rectangles, bool shifted,
                                                    ForEachPart const& for_each_part) const {
  Packed out;
  out.rectangles.reserve(rectangles.size());
  out.parts.reserve(rectangles.size());
  for (CopiedRectangle const& rectangle : rectangles) {
    Box const box = shifted ? rectangle.cells.shift(rectangle.shift) : rectangle.cells;
    int const first = int(out.parts.size()), parity = (box.lower[0] + box.lower[1] + box.lower[2] + int(colours_)) & 1;
    for_each_part(box, [&](Box const& part, Placement const& at) {
      out.parts.push_back({extent_of(part), steps(box.lower, part.lower), at});
    });
    out.rectangles.push_back(
        {first, int(out.parts.size()) - first, extent_of(box), parity, {rectangle.rank, places(box)}});
  }
  out.parts.shrink_to_fit();
  return out;
}

template <class F>
void RectangleExchange::for_each_part_of(Packed const& packed, std::size_t n, F&& f) {
  Packed::Rectangle const& rectangle = packed.rectangles[n];
  Placement const message = dense(rectangle.extent);
  Packed::Part const* part = packed.parts.data() + rectangle.first_part;
  for (Packed::Part const* const end = part + rectangle.parts; part != end; ++part)
    f(*part, from(message, part->first));
}

RectangleExchange::Lists RectangleExchange::lists() const {
  Lists out;
  for (Pair const& l : local_)
    for_each_row(l.extent, l.at, l.copy, [&](auto at, auto copy, int length) {
      for (int i = 0; i < length; ++i) out.local.emplace_back(at + i, copy + i);
    });
  auto const list = [&](Packed const& all, Lists::Pairs& pairs, std::vector<Parcel>& parcels) {
    std::ptrdiff_t first = 0;
    for (std::size_t n = 0; n < all.rectangles.size(); ++n) {
      Packed::Rectangle const& rectangle = all.rectangles[n];
      for_each_part_of(all, n, [&](Packed::Part const& p, Placement const& message) {
        if (colours_ == Colours::all)
          for_each_row(p.extent, p.at, message, [&](auto at, auto packed, int length) {
            for (int i = 0; i < length; ++i) pairs.emplace_back(at + i, first + packed + i);
          });
        else
          for_each_of_colour(rectangle.extent, rectangle.parity, p.extent, p.first, p.at,
                             [&](auto at, auto packed) { pairs.emplace_back(at, first + packed); });
      });
      parcels.push_back(rectangle.parcel);
      first += rectangle.parcel.values;
    }
  };
  list(asked_, out.asked, out.asked_parcels);
  list(wanted_, out.wanted, out.wanted_parcels);
  return out;
}

void RectangleExchange::start(float const* cells, float* copies) const {
  exchange_.start([&](std::size_t n, float* out) {
    std::size_t const number = relays_ ? std::size_t(relays_->plan.sent_first[n].own) : n;
    Packed::Rectangle const& asked = asked_.rectangles[number];
    for_each_part_of(asked_, number, [&](Packed::Part const& p, Placement const& message) {
      if (colours_ == Colours::all)
        for_each_row(p.extent, p.at, message,
                     [&](auto at, auto packed, int length) { copy_row(cells + at, length, out + packed); });
      else
        for_each_of_colour(asked.extent, asked.parity, p.extent, p.first, p.at,
                           [&](auto at, auto packed) { out[packed] = cells[at]; });
    });
  });
  for (Pair const& l : local_)
    for_each_row(l.extent, l.at, l.copy,
                 [&](auto at, auto copy, int length) { copy_row(cells + at, length, copies + copy); });
}

/// Take the values of a rectangle that this rank reads.
void RectangleExchange::unpack(std::size_t n, float const* in, float* copies) const {
  Packed::Rectangle const& wanted = wanted_.rectangles[n];
  for_each_part_of(wanted_, n, [&](Packed::Part const& p, Placement const& message) {
    if (colours_ == Colours::all)
      for_each_row(p.extent, message, p.at,
                   [&](auto packed, auto at, int length) { copy_row(in + packed, length, copies + at); });
    else
      for_each_of_colour(wanted.extent, wanted.parity, p.extent, p.first, p.at,
                         [&](auto at, auto packed) { copies[at] = in[packed]; });
  });
}

void RectangleExchange::finish(float* copies) const {
  if (!relays_) return exchange_.finish([&](std::size_t n, float const* in) { unpack(n, in, copies); });
  auto const& [plan, second_round, first, values] = *relays_;
  float* const passed_on = relays_->values.data();
  exchange_.finish([&](std::size_t n, float const* in) {
    auto const& step = plan.received_first[n];
    if (step.own >= 0) return unpack(std::size_t(step.own), in, copies);
    std::size_t const place = std::size_t(step.passed_on);
    std::copy_n(in, first[place + 1] - first[place], passed_on + first[place]);
  });
  second_round.update(
      [&](std::size_t n, float* out) {
        std::size_t const place = std::size_t(plan.sent_second[n].passed_on);
        std::copy_n(passed_on + first[place], first[place + 1] - first[place], out);
      },
      [&](std::size_t n, float const* in) { unpack(std::size_t(plan.received_second[n].own), in, copies); });
}

void RectangleExchange::add(float const* copies, float* cells) const {
  for (Pair const& l : local_)
    for_each_row(l.extent, l.copy, l.at,
                 [&](auto copy, auto at, int length) { add_row(copies + copy, length, cells + at); });
  exchange_.fold(
      [&](std::size_t n, float* out) {  // of cells with several copies, the sum
        std::fill_n(out, wanted_.rectangles[n].parcel.values, 0.0f);
        for_each_part_of(wanted_, n, [&](Packed::Part const& p, Placement const& message) {
          for_each_row(p.extent, p.at, message,
                       [&](auto at, auto packed, int length) { add_row(copies + at, length, out + packed); });
        });
      },
      [&](std::size_t n, float const* in) {
        for_each_part_of(asked_, n, [&](Packed::Part const& p, Placement const& message) {
          for_each_row(p.extent, message, p.at,
                       [&](auto packed, auto at, int length) { add_row(in + packed, length, cells + at); });
        });
      });
}

}  // namespace amrpic::cycle
