#include "particle/remote_bricks.hpp"

#include <algorithm>
#include <tuple>

namespace amrpic {

namespace {

Window window_of(Hierarchy const& hierarchy, int l, Box const& cells) {
  Level const& level = hierarchy.level(l);
  Window out{l, cells, {}, false};
  GlobalIndex found = 0;
  level.for_each_overlap(cells, [&](int box, Box const& part, Index3 const& shift) {
    out.parts.push_back({box, part, shift});
    found += part.cells();
  });
  out.whole = found == level.cut_at_walls(cells).cells();
  return out;
}

/// Call f(brick, window, part, owner) for the parts of the windows of some bricks, in the order of messages.
template <class F>
void for_each_part(Hierarchy const& hierarchy, std::vector<BrickWindows> const& bricks, F&& f) {
  for (std::size_t b = 0; b < bricks.size(); ++b)
    for (std::size_t w = 0; w < bricks[b].windows.size(); ++w) {
      Window const& window = bricks[b].windows[w];
      for (Window::Part const& part : window.parts) f(b, w, part, hierarchy.level(window.level).owner(part.box));
    }
}

std::vector<BrickWindows> windows_of(Hierarchy const& hierarchy, std::vector<Home> const& bricks, bool matched,
                                     int reach) {
  std::vector<BrickWindows> out;
  out.reserve(bricks.size());
  for (Home const& brick : bricks) out.push_back(windows_of(hierarchy, brick, matched, reach));
  return out;
}

/// Send lists to other ranks, and return those that come from others, in the order of ranks. Collective.
BricksOfRanks exchanged(Communicator const& comm, std::map<int, std::vector<Home>> const& to) {
  std::vector<std::pair<int, std::int64_t>> counts;
  for (auto const& [rank, list] : to) counts.emplace_back(rank, std::int64_t(list.size()));
  BricksOfRanks from;
  for (auto const& [rank, count] : comm.announced(counts))
    from.emplace_back(rank, std::vector<Home>(std::size_t(count)));
  Messages messages;
  for (auto& [rank, list] : from) messages.receive(comm, list.data(), list.size(), rank);
  for (auto const& [rank, list] : to) messages.send(comm, list.data(), list.size(), rank);
  messages.wait_for_all();
  return from;
}

/// Call f(place, count, row) for the rows of cells along x of a part of a box, places counted from the box's first
/// cell.
template <class F>
void for_each_row_of(Box const& box, Box const& part, F&& f) {
  for (int k = part.lower[2]; k <= part.upper[2]; ++k)
    for (int j = part.lower[1]; j <= part.upper[1]; ++j)
      f(std::size_t(box.offset({part.lower[0], j, k})), std::size_t(part.extent(0)));
}

}  // namespace

BrickWindows windows_of(Hierarchy const& hierarchy, Home const& brick, bool matched, int reach) {
  BrickWindows out;
  out.home = brick;
  out.cells = cells_of(hierarchy, brick);
  if (matched) out.buffer = buffer_of(hierarchy, brick.level, out.cells);
  out.windows.push_back(window_of(hierarchy, brick.level, out.cells.grow(reach)));
  std::size_t const coarser = std::max(out.buffer.coarse.size(), std::size_t(out.windows[0].whole ? 0 : 1));
  Box cells = out.cells;
  for (std::size_t r = 1; r <= coarser; ++r) {
    cells = cells.coarsen(refinement_ratio);
    out.windows.push_back(window_of(hierarchy, brick.level - int(r), cells.grow(reach)));
  }
  return out;
}

std::vector<int> first_servers(Hierarchy const& hierarchy, Servers const& servers, std::vector<Home> const& bricks) {
  std::vector<int> out;
  out.reserve(bricks.size());
  for (Home const& brick : bricks) {
    auto const place = servers.curve().place(brick.level, cells_of(hierarchy, brick).lower);
    int const first = servers.server(place);
    bool const few = servers.server(place + BrickCurve::per_brick - 1) - first < 2;  // a sum of one or two at the owner, which has their cells
    out.push_back(few ? hierarchy.level(brick.level).owner(brick.box) : first);
  }
  return out;
}

RemotePlan::RemotePlan(Hierarchy const& hierarchy, std::vector<BrickWindows> bricks, std::vector<int> const& servers,
                       BricksOfRanks const& of_servers, BricksOfRanks const& of_others, bool matched, int reach)
    : bricks_(std::move(bricks)) {
  int const me = hierarchy.comm().rank();
  auto const own_part = [&](int l, Window::Part const& part) {
    return OwnPart{l, part.box - hierarchy.level(l).first_local_box(), part.in_box()};
  };
  std::map<Home, std::size_t> place;
  for (std::size_t b = 0; b < bricks_.size(); ++b) {
    place[bricks_[b].home] = b;
    first_.emplace_back();
    for (Window const& window : bricks_[b].windows) {
      first_.back().push_back(cells_);
      cells_ += std::size_t(window.cells.cells());
    }
  }
  std::map<int, std::vector<WindowPart>> wanted_of, brought_by;
  for_each_part(hierarchy, bricks_, [&](std::size_t b, std::size_t w, Window::Part const& part, int owner) {
    if (servers[b] != me)
      brought_by[servers[b]].push_back(part_of(b, w, part));
    else if (owner == me)
      local_.push_back({own_part(bricks_[b].windows[w].level, part), part_of(b, w, part)});
    else
      wanted_of[owner].push_back(part_of(b, w, part));
  });
  auto const parcels = [](std::map<int, std::vector<WindowPart>> const& of_ranks, std::vector<WindowPart>& parts) {
    std::vector<Parcel> out;
    for (auto const& [rank, list] : of_ranks)
      for (WindowPart const& part : list) {
        out.push_back({rank, part.cells.cells()});
        parts.push_back(part);
      }
    return out;
  };
  std::vector<Parcel> asked, passed_on;
  for (auto const& [rank, list] : of_others) {
    auto const windows = windows_of(hierarchy, list, matched, reach);
    for_each_part(hierarchy, windows,
                  [&, reader = rank](std::size_t b, std::size_t w, Window::Part const& part, int owner) {
                    if (owner != me) return;
                    asked.push_back({reader, part.cells.cells()});
                    asked_.push_back(own_part(windows[b].windows[w].level, part));
                  });
  }
  for (auto const& [rank, list] : of_servers)
    for (Home const& brick : list) {
      std::size_t const b = place.at(brick);
      for (std::size_t w = 0; w < bricks_[b].windows.size(); ++w)
        for (Window::Part const& part : bricks_[b].windows[w].parts) {
          passed_on.push_back({rank, part.cells.cells()});
          passed_on_.push_back(part_of(b, w, part));
        }
    }
  exchange_ = Exchange<Real>(hierarchy.comm(), asked, parcels(wanted_of, wanted_));
  between_servers_ = Exchange<Real>(hierarchy.comm(), passed_on, parcels(brought_by, brought_));
}

template <class Write>
std::vector<Real> RemotePlan::read(std::size_t per_cell, Write const& write) const {
  std::vector<Real> out(per_cell * cells_);
  auto const unpack = [&](WindowPart const& to, Real const* in) {
    for_each_row_of(to.window, to.cells, [&](std::size_t place, std::size_t count) {
      std::copy_n(in, per_cell * count, out.data() + per_cell * (to.first + place));
      in += per_cell * count;
    });
  };
  auto const pack = [&](WindowPart const& from, Real* to) {
    for_each_row_of(from.window, from.cells, [&](std::size_t place, std::size_t count) {
      to = std::copy_n(out.data() + per_cell * (from.first + place), per_cell * count, to);
    });
  };
  exchange_.update([&](std::size_t n, Real* to) { write(asked_[n], to); },
                   [&](std::size_t n, Real const* in) { unpack(wanted_[n], in); }, per_cell);
  std::vector<Real> cells;
  for (LocalPart const& part : local_) {
    cells.resize(per_cell * std::size_t(part.own.cells.cells()));
    write(part.own, cells.data());
    unpack(part.window, cells.data());
  }
  between_servers_.update([&](std::size_t n, Real* to) { pack(passed_on_[n], to); },
                          [&](std::size_t n, Real const* in) { unpack(brought_[n], in); }, per_cell);
  return out;
}

std::vector<Real> RemotePlan::read(ElectricField const& field) const {
  return read(ElectricField::components_per_cell,
              [&](OwnPart const& of, Real* to) { field.write_part(of.level, of.box, of.cells, to); });
}

std::vector<Real> RemotePlan::read(Field const& density) const {
  Hierarchy const& hierarchy = density.hierarchy();
  return read(1, [&](OwnPart const& of, Real* to) {
    Level const& level = hierarchy.level(of.level);
    int const box = level.first_local_box() + of.box;
    Real const* const own = density.level(of.level).data() + level.local_offset(box);
    for_each_row_of(level.box(box), of.cells,
                    [&](std::size_t place, std::size_t count) { to = std::copy_n(own + place, count, to); });
  });
}

void RemotePlan::add(std::vector<Real> values, Field& density) const {
  Hierarchy const& hierarchy = density.hierarchy();
  auto const pack = [&](WindowPart const& from, Real* out) {
    for_each_row_of(from.window, from.cells, [&](std::size_t place, std::size_t count) {
      out = std::copy_n(values.data() + from.first + place, count, out);
    });
  };
  auto const add_to = [&](OwnPart const& to, Real const* in) {
    Level const& level = hierarchy.level(to.level);
    int const box = level.first_local_box() + to.box;
    Real* const own = density.level(to.level).data() + level.local_offset(box);
    for_each_row_of(level.box(box), to.cells, [&](std::size_t place, std::size_t count) {
      for (std::size_t n = 0; n < count; ++n) own[place + n] += *in++;
    });
  };
  auto const add_to_window = [&](WindowPart const& to, Real const* in) {
    for_each_row_of(to.window, to.cells, [&](std::size_t place, std::size_t count) {
      for (std::size_t n = 0; n < count; ++n) values[to.first + place + n] += *in++;
    });
  };
  between_servers_.fold([&](std::size_t n, Real* out) { pack(brought_[n], out); },
                        [&](std::size_t n, Real const* in) { add_to_window(passed_on_[n], in); });
  std::vector<Real> cells;
  for (LocalPart const& part : local_) {
    cells.resize(std::size_t(part.own.cells.cells()));
    pack(part.window, cells.data());
    add_to(part.own, cells.data());
  }
  exchange_.fold([&](std::size_t n, Real* out) { pack(wanted_[n], out); },
                 [&](std::size_t n, Real const* in) { add_to(asked_[n], in); });
}

RemotePlan const& RemoteBricks::plan(bool matched, int reach) const {
  auto& plan = plans_[{matched, reach}];
  if (plan) return *plan;
  Communicator const& comm = hierarchy_->comm();
  std::map<int, std::vector<Home>> to_servers, to_owners;
  for (std::size_t b = 0; b < bricks_.size(); ++b)
    if (servers_[b] != comm.rank()) to_servers[servers_[b]].push_back(bricks_[b]);
  auto const of_servers = exchanged(comm, to_servers);

  auto bricks = bricks_;
  for (auto const& [rank, list] : of_servers) bricks.insert(bricks.end(), list.begin(), list.end());
  auto const passed_on = bricks.begin() + std::ptrdiff_t(bricks_.size());
  std::sort(passed_on, bricks.end());
  auto const is_mine = [&](Home const& brick) { return std::binary_search(bricks_.begin(), bricks_.end(), brick); };
  bricks.erase(std::remove_if(passed_on, std::unique(passed_on, bricks.end()), is_mine), bricks.end());
  auto servers = servers_;
  servers.resize(bricks.size(), comm.rank());

  auto windows = windows_of(*hierarchy_, bricks, matched, reach);
  for_each_part(*hierarchy_, windows, [&](std::size_t b, std::size_t, Window::Part const&, int owner) {
    if (owner == comm.rank() || servers[b] != comm.rank()) return;
    auto& list = to_owners[owner];
    if (list.empty() || !(list.back() == bricks[b])) list.push_back(bricks[b]);
  });
  auto const of_others = exchanged(comm, to_owners);
  plan = std::make_unique<RemotePlan const>(*hierarchy_, std::move(windows), servers, of_servers, of_others, matched,
                                            reach);
  return *plan;
}

}  // namespace amrpic
