#include "particle/remote_bricks.hpp"

#include <algorithm>
#include <cstring>

#include "base/brought.hpp"
#include "particle/home_word.hpp"

namespace amrpic {

namespace {

Region region_of(Hierarchy const& hierarchy, int l, Box const& cells) {
  Level const& level = hierarchy.level(l);
  return {l, cells, overlaps(level, cells), level.cells_in(cells) == level.cut_at_walls(cells).cells()};
}

/// Call f(region, part, owner) for the parts of the regions of a brick, in the order of messages.
template <class F>
void for_each_part(Hierarchy const& hierarchy, BrickRegions const& brick, F&& f) {
  for (std::size_t w = 0; w < brick.regions.size(); ++w) {
    Region const& region = brick.regions[w];
    for (Overlap const& o : region.parts) f(w, o, hierarchy.level(region.level).owner(o.box));
  }
}

/// What a rank sends of bricks: which, and values of their cells, if any.
struct OfRank {
  int rank;
  std::vector<Home> bricks;
  std::vector<Real> values;
};

/// Send bricks to other ranks, with the values that pack(rank, values) appends, and return what comes from others, in
/// the order of ranks. Collective.
template <class Pack>
std::vector<OfRank> exchanged(Communicator const& comm, std::map<int, std::vector<Home>> const& to, Pack&& pack) {
  std::map<int, std::vector<std::int64_t>> words;
  for (auto const& [rank, bricks] : to) {
    std::vector<Real> values;
    pack(rank, values);
    auto& out = words[rank];
    out.reserve(1 + bricks.size() + values.size());
    out.push_back(std::int64_t(bricks.size()));
    for (Home const& brick : bricks) out.push_back(std::int64_t(word_of(brick)));
    out.resize(out.size() + values.size());
    std::memcpy(out.data() + out.size() - values.size(), values.data(), values.size() * sizeof(Real));
  }
  std::vector<OfRank> out;
  for (auto const& [rank, in] : brought(comm, words)) {
    OfRank& of = out.emplace_back();
    of.rank = rank;
    std::size_t const count = std::size_t(in.front());
    for (std::size_t n = 1; n <= count; ++n) of.bricks.push_back(home_of(std::uint64_t(in[n])));
    of.values.resize(in.size() - 1 - count);
    std::memcpy(of.values.data(), in.data() + 1 + count, of.values.size() * sizeof(Real));
  }
  return out;
}

/// Copy the values in a part of a box, `per_cell` in each cell, to `out`, or those that come to the part, or add these;
/// `values`: of the whole box. Each returns what follows.
Real* copy_from(Box const& box, Real const* values, Box const& part, Real* out, std::size_t per_cell = 1) {
  std::size_t const count = per_cell * std::size_t(part.extent(0));
  for_each_row(part, [&](Index3 const& first) {
    out = std::copy_n(values + per_cell * std::size_t(box.offset(first)), count, out);
  });
  return out;
}
void copy_to(Box const& box, Real* values, Box const& part, Real const* in, std::size_t per_cell) {
  std::size_t const count = per_cell * std::size_t(part.extent(0));
  for_each_row(part, [&](Index3 const& first) {
    std::copy_n(in, count, values + per_cell * std::size_t(box.offset(first)));
    in += count;
  });
}
Real const* add_to(Box const& box, Real* values, Box const& part, Real const* in) {
  for_each_row(part, [&](Index3 const& first) {
    Real* const row = values + box.offset(first);
    for (int n = 0; n < part.extent(0); ++n) row[n] += *in++;
  });
  return in;
}

/// pack(rank, out) for `exchanged`: the values in parts of regions, if there are any.
template <class Part>
auto packed(std::map<int, std::vector<Part>> const& of_ranks, std::vector<Real> const* values) {
  return [&of_ranks, values](int rank, std::vector<Real>& out) {
    if (!values) return;
    for (Part const& part : of_ranks.at(rank)) {
      out.resize(out.size() + std::size_t(part.cells.cells()));
      copy_from(part.region, values->data() + part.first, part.cells, out.data() + out.size() - part.cells.cells());
    }
  };
}

/// A parcel for each of those parts, which are appended to a list.
template <class Part>
std::vector<Parcel> parcels(std::map<int, std::vector<Part>> const& of_ranks, std::vector<Part>& list) {
  std::vector<Parcel> out;
  for (auto const& [rank, parts] : of_ranks)
    for (Part const& part : parts) {
      out.push_back({rank, part.cells.cells()});
      list.push_back(part);
    }
  return out;
}

}  // namespace

BrickRegions regions_of(Hierarchy const& hierarchy, Home const& brick, bool matched, int reach) {
  BrickRegions out;
  out.home = brick;
  out.cells = cells_of(hierarchy, brick);
  if (matched) out.buffer = buffer_of(hierarchy, brick.level, out.cells);
  out.regions.push_back(region_of(hierarchy, brick.level, out.cells.grow(reach)));
  std::size_t const coarser = std::max(out.buffer.coarse.size(), std::size_t(out.regions[0].whole ? 0 : 1));
  Box cells = out.cells;
  for (std::size_t r = 1; r <= coarser; ++r) {
    cells = cells.coarsen(refinement_ratio);
    out.regions.push_back(region_of(hierarchy, brick.level - int(r), cells.grow(reach)));
  }
  return out;
}

std::vector<int> first_servers(Hierarchy const& hierarchy, Servers const& servers, std::vector<Home> const& bricks) {
  std::vector<int> out;
  out.reserve(bricks.size());
  for (Home const& brick : bricks)
    out.push_back(servers.server(servers.curve().place(brick.level, cells_of(hierarchy, brick).lower)));
  return out;
}

RemotePlan::RemotePlan(Hierarchy const& hierarchy, std::vector<Home> const& bricks, std::vector<int> const& servers,
                       bool matched, int reach)
    : hierarchy_(&hierarchy), matched_(matched), reach_(reach) {
  for (std::size_t b = 0; b < bricks.size(); ++b) append(regions_of(hierarchy, bricks[b], matched, reach), servers[b]);
}

void RemotePlan::append(BrickRegions brick, int server) {
  auto& first = first_.emplace_back();
  for (Region const& region : brick.regions) {
    first.push_back(cells_);
    cells_ += std::size_t(region.cells.cells());
  }
  bricks_.push_back(std::move(brick));
  servers_.push_back(server);
}

void RemotePlan::announce_with(std::vector<Real>* values, Field* density) {
  is_announced_ = true;
  meet_servers(values);
  meet_owners(values, density);
}

/// Between the first server of each brick and its others: what these add, and later what they read.
void RemotePlan::meet_servers(std::vector<Real>* values) {
  Communicator const& comm = hierarchy_->comm();
  std::map<Home, std::size_t> place;
  std::map<int, std::vector<Home>> to_servers;
  std::map<int, std::vector<RegionPart>> brought_by;
  for (std::size_t b = 0; b < bricks_.size(); ++b) {
    place[bricks_[b].home] = b;
    if (servers_[b] == comm.rank()) continue;
    to_servers[servers_[b]].push_back(bricks_[b].home);
    auto& parts = brought_by[servers_[b]];
    for_each_part(*hierarchy_, bricks_[b],
                  [&](std::size_t w, Overlap const& o, int) { parts.push_back(part_of(b, w, o)); });
  }
  auto const of_servers = exchanged(comm, to_servers, packed(brought_by, values));

  std::vector<Home> more;
  for (OfRank const& of : of_servers)
    for (Home const& brick : of.bricks)
      if (place.emplace(brick, 0).second) more.push_back(brick);
  std::sort(more.begin(), more.end());
  for (Home const& brick : more) {
    place[brick] = bricks_.size();
    append(regions_of(*hierarchy_, brick, matched_, reach_), comm.rank());
  }
  std::vector<Parcel> passed_on;
  if (values) values->resize(cells_, 0);
  for (OfRank const& of : of_servers) {
    Real const* in = of.values.data();
    for (Home const& brick : of.bricks) {
      std::size_t const b = place.at(brick);
      for_each_part(*hierarchy_, bricks_[b], [&](std::size_t w, Overlap const& o, int) {
        passed_on.push_back({of.rank, o.part.cells()});
        passed_on_.push_back(part_of(b, w, o));
        if (values) in = add_to_region(in, passed_on_.back(), *values);
      });
    }
  }
  between_servers_ = Exchange<Real>(comm, passed_on, parcels(brought_by, brought_));
}

/// The same between the first servers and the owners of cells.
void RemotePlan::meet_owners(std::vector<Real>* values, Field* density) {
  Communicator const& comm = hierarchy_->comm();
  int const me = comm.rank();
  std::map<int, std::vector<Home>> to_owners;
  std::map<int, std::vector<RegionPart>> wanted_of;
  auto const own_part = [&](int l, Overlap const& o) {
    return OwnPart{l, o.box - hierarchy_->level(l).first_local_box(), o.in_box()};
  };
  for (std::size_t b = 0; b < bricks_.size(); ++b) {
    if (servers_[b] != me) continue;
    for_each_part(*hierarchy_, bricks_[b], [&](std::size_t w, Overlap const& o, int owner) {
      if (owner == me) return local_.push_back({own_part(bricks_[b].regions[w].level, o), part_of(b, w, o)});
      wanted_of[owner].push_back(part_of(b, w, o));
      auto& list = to_owners[owner];
      if (list.empty() || !(list.back() == bricks_[b].home)) list.push_back(bricks_[b].home);
    });
  }
  auto const of_others = exchanged(comm, to_owners, packed(wanted_of, values));
  if (values) add_local(*values, *density);
  std::vector<Parcel> asked;
  for (OfRank const& of : of_others) {
    Real const* in = of.values.data();
    for (Home const& home : of.bricks) {
      BrickRegions const brick = regions_of(*hierarchy_, home, matched_, reach_);
      for_each_part(*hierarchy_, brick, [&](std::size_t w, Overlap const& o, int owner) {
        if (owner != me) return;
        asked.push_back({of.rank, o.part.cells()});
        asked_.push_back(own_part(brick.regions[w].level, o));
        if (values) in = add_to_cells(in, asked_.back(), *density);
      });
    }
  }
  exchange_ = Exchange<Real>(comm, asked, parcels(wanted_of, wanted_));
}

template <class Write>
std::vector<Real> RemotePlan::read(std::size_t per_cell, Write const& write) const {
  std::vector<Real> out(per_cell * cells_);
  auto const unpack = [&](RegionPart const& to, Real const* in) {
    copy_to(to.region, out.data() + per_cell * to.first, to.cells, in, per_cell);
  };
  exchange_.update([&](std::size_t n, Real* to) { write(asked_[n], to); },
                   [&](std::size_t n, Real const* in) { unpack(wanted_[n], in); }, per_cell);
  std::vector<Real> cells;
  for (LocalPart const& part : local_) {
    cells.resize(per_cell * std::size_t(part.own.cells.cells()));
    write(part.own, cells.data());
    unpack(part.region, cells.data());
  }
  between_servers_.update(
      [&](std::size_t n, Real* to) {
        RegionPart const& from = passed_on_[n];
        copy_from(from.region, out.data() + per_cell * from.first, from.cells, to, per_cell);
      },
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
    copy_from(level.box(box), density.level(of.level).data() + level.local_offset(box), of.cells, to);
  });
}

Real* RemotePlan::pack(std::vector<Real> const& values, RegionPart const& from, Real* out) {
  return copy_from(from.region, values.data() + from.first, from.cells, out);
}

Real const* RemotePlan::add_to_region(Real const* in, RegionPart const& to, std::vector<Real>& values) {
  return add_to(to.region, values.data() + to.first, to.cells, in);
}

/// Add to cells of this rank.
Real const* RemotePlan::add_to_cells(Real const* in, OwnPart const& to, Field& density) const {
  Level const& level = hierarchy_->level(to.level);
  int const box = level.first_local_box() + to.box;
  return add_to(level.box(box), density.level(to.level).data() + level.local_offset(box), to.cells, in);
}

void RemotePlan::add_local(std::vector<Real> const& values, Field& density) const {
  std::vector<Real> cells;
  for (LocalPart const& part : local_) {
    cells.resize(std::size_t(part.own.cells.cells()));
    pack(values, part.region, cells.data());
    add_to_cells(cells.data(), part.own, density);
  }
}

void RemotePlan::add(std::vector<Real> values, Field& density) {
  if (!is_announced_) return announce_with(&values, &density);
  values.resize(cells_, 0);
  between_servers_.fold([&](std::size_t n, Real* out) { pack(values, brought_[n], out); },
                        [&](std::size_t n, Real const* in) { add_to_region(in, passed_on_[n], values); });
  add_local(values, density);
  exchange_.fold([&](std::size_t n, Real* out) { pack(values, wanted_[n], out); },
                 [&](std::size_t n, Real const* in) { add_to_cells(in, asked_[n], density); });
}

RemotePlan& RemoteBricks::own_plan(bool matched, int reach) const {
  auto const at = plans_.find({matched, reach});
  if (at != plans_.end()) return at->second;
  return plans_.try_emplace({matched, reach}, *hierarchy_, bricks_, servers_, matched, reach).first->second;
}

RemotePlan const& RemoteBricks::plan(bool matched, int reach) const {
  RemotePlan& out = own_plan(matched, reach);
  if (!out.is_announced()) out.announce();
  return out;
}

}  // namespace amrpic
