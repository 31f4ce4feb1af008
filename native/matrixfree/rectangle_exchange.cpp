#include "matrixfree/rectangle_exchange.hpp"

#include <map>
#include <numeric>

#include "mesh/box_set.hpp"

namespace amrpic::matrixfree {

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

Placement dense(Index3 const& extent, std::ptrdiff_t origin) {
  return {origin, extent[0], std::ptrdiff_t(extent[0]) * extent[1]};
}

/// Exchange requests between all ranks: `mine[r]` goes to rank r; returns what each rank requests of this one.
/// Collective.
std::vector<std::vector<int>> all_to_all(MPI_Comm comm, std::vector<std::vector<int>> const& mine) {
  int const ranks = int(mine.size());
  std::vector<int> send(mine.size()), receive(mine.size());
  for (int r = 0; r < ranks; ++r) send[std::size_t(r)] = int(mine[std::size_t(r)].size());
  MPI_Alltoall(send.data(), 1, MPI_INT, receive.data(), 1, MPI_INT, comm);
  std::vector<std::vector<int>> out(mine.size());
  std::vector<MPI_Request> requests;
  for (int r = 0; r < ranks; ++r) {
    out[std::size_t(r)].resize(std::size_t(receive[std::size_t(r)]));
    if (receive[std::size_t(r)] > 0)
      MPI_Irecv(out[std::size_t(r)].data(), receive[std::size_t(r)], MPI_INT, r, 0, comm, &requests.emplace_back());
    if (send[std::size_t(r)] > 0)
      MPI_Isend(mine[std::size_t(r)].data(), send[std::size_t(r)], MPI_INT, r, 0, comm, &requests.emplace_back());
  }
  MPI_Waitall(int(requests.size()), requests.data(), MPI_STATUSES_IGNORE);
  return out;
}

/// Cells of one rank whose copies lie in one rectangle of memory, which the copy of a cell of index zero would begin.
struct Region {
  int owner;
  Placement copy;
  std::vector<Box> boxes;
};

/// Wanted cells, by owner and by where their copies lie, in as few boxes as contain them.
std::vector<Region> regions_of(Level const& level, std::vector<Wanted> const& wanted) {
  std::vector<Region> out;
  std::map<std::array<std::ptrdiff_t, 4>, std::size_t> known;
  for (Wanted const& w : wanted) {
    Placement copy = w.copy;
    copy.origin = copy.place(-w.cells.lower[0], -w.cells.lower[1], -w.cells.lower[2]);
    int const owner = level.owner(w.box);
    auto const [at, fresh] =
        known.emplace(std::array<std::ptrdiff_t, 4>{owner, copy.origin, copy.pitch_y, copy.pitch_z}, out.size());
    if (fresh) out.push_back({owner, copy, {}});
    out[at->second].boxes.push_back(w.cells);
  }
  for (Region& region : out) region.boxes = joined(std::move(region.boxes));
  return out;
}

/// Wait for messages on their way.
void wait(std::vector<MPI_Request>& requests) {
  MPI_Waitall(int(requests.size()), requests.data(), MPI_STATUSES_IGNORE);
  requests.clear();
}

Index3 extent_of(Box const& box) { return {box.extent(0), box.extent(1), box.extent(2)}; }

/// A placement that begins at another cell.
Placement from(Placement at, Index3 const& steps) {
  at.origin = at.place(steps[0], steps[1], steps[2]);
  return at;
}

/// Call f(part, where it lies) for the parts of a box in own blocks.
template <class F>
void for_each_own_part(Layout const& layout, Box const& box, F&& f) {
  for (std::size_t b = 0; b < layout.own_blocks(); ++b) {
    CellBlock const& block = layout.blocks()[b];
    Box const part = box.intersect(block.box);
    if (part.empty()) continue;
    Placement at = block.cells;
    at.origin = block.place(part.lower);
    f(part, at);
  }
}

Index3 steps(Index3 const& first, Index3 const& to) { return {to[0] - first[0], to[1] - first[1], to[2] - first[2]}; }

}  // namespace

RectangleExchange::RectangleExchange(MPI_Comm comm, Level const& level, Layout const& layout,
                                     std::vector<Wanted> const& wanted)
    : comm_(comm) {
  std::map<int, Neighbour> sources;
  std::vector<std::vector<int>> requests(std::size_t(level.ranks()));
  for (Region const& region : regions_of(level, wanted))
    for (Box const& box : region.boxes) {
      if (region.owner == level.rank()) {
        for_each_own_part(layout, box, [&](Box const& part, Placement const& at) {
          local_.push_back({extent_of(part), at, from(region.copy, part.lower)});
        });
        continue;
      }
      Neighbour& source = sources[region.owner];
      source.rank = region.owner;
      source.boxes.push_back(
          {extent_of(box), from(region.copy, box.lower), dense(extent_of(box), std::ptrdiff_t(source.cells))});
      source.cells += std::size_t(box.cells());
      auto& request = requests[std::size_t(region.owner)];
      request.insert(request.end(), box.lower.begin(), box.lower.end());
      request.insert(request.end(), box.upper.begin(), box.upper.end());
    }
  for (auto& [rank, source] : sources) {
    source.buffer.resize(source.cells);
    sources_.push_back(std::move(source));
  }
  if (level.ranks() == 1) return;
  auto const asked = all_to_all(comm, requests);
  for (int rank = 0; rank < level.ranks(); ++rank) {
    auto const& list = asked[std::size_t(rank)];
    if (list.empty()) continue;
    Neighbour reader;
    reader.rank = rank;
    for (std::size_t n = 0; n < list.size(); n += 6) {
      Box const box{{list[n], list[n + 1], list[n + 2]}, {list[n + 3], list[n + 4], list[n + 5]}};
      Placement const packed = dense(extent_of(box), std::ptrdiff_t(reader.cells));
      for_each_own_part(layout, box, [&](Box const& part, Placement const& at) {
        reader.boxes.push_back({extent_of(part), at, from(packed, steps(box.lower, part.lower))});
      });
      reader.cells += std::size_t(box.cells());
    }
    reader.buffer.resize(reader.cells);
    readers_.push_back(std::move(reader));
  }
}

/// Begin to send the buffers of `from` and to receive those of `to`.
void RectangleExchange::pass(std::vector<Neighbour> const& from, std::vector<Neighbour> const& to) const {
  for (Neighbour const& n : to)
    MPI_Irecv(n.buffer.data(), int(n.buffer.size()), MPI_FLOAT, n.rank, 0, comm_, &receiving_.emplace_back());
  for (Neighbour const& n : from) {
    MPI_Isend(n.buffer.data(), int(n.buffer.size()), MPI_FLOAT, n.rank, 0, comm_, &sending_.emplace_back());
    ++messages_;
    bytes_ += std::int64_t(n.buffer.size() * sizeof(float));
  }
}

/// Put values into the messages that these neighbours get.
void RectangleExchange::pack(std::vector<Neighbour> const& neighbours, float const* values) {
  for (Neighbour const& n : neighbours)
    for (PackedBox const& p : n.boxes)
      for_each_row(p.extent, p.at, p.packed, [&](auto at, auto packed, int length) {
        std::copy_n(values + at, length, n.buffer.data() + packed);
      });
}

void RectangleExchange::poll() const {
  int done;
  MPI_Testall(int(receiving_.size()), receiving_.data(), &done, MPI_STATUSES_IGNORE);
  MPI_Testall(int(sending_.size()), sending_.data(), &done, MPI_STATUSES_IGNORE);
}

void RectangleExchange::start(float const* cells, float* copies) const {
  pack(readers_, cells);
  pass(readers_, sources_);
  for (Local const& l : local_)
    for_each_row(l.extent, l.cells, l.copy,
                 [&](auto at, auto copy, int length) { std::copy_n(cells + at, length, copies + copy); });
}

/// Does not wait for what this rank sent: others receive it when they need it, and a rank that waited for that would
/// compute after them, not at the same time.
void RectangleExchange::finish(float* copies) const {
  wait(receiving_);
  for (Neighbour const& n : sources_)
    for (PackedBox const& p : n.boxes)
      for_each_row(p.extent, p.packed, p.at, [&](auto packed, auto at, int length) {
        std::copy_n(n.buffer.data() + packed, length, copies + at);
      });
}

void RectangleExchange::settle() const { wait(sending_); }

void RectangleExchange::add(float const* copies, float* cells) const {
  auto add_row = [](float const* from, int length, float* to) {
    for (int i = 0; i < length; ++i) to[i] += from[i];
  };
  pack(sources_, copies);
  pass(sources_, readers_);
  for (Local const& l : local_)
    for_each_row(l.extent, l.copy, l.cells,
                 [&](auto copy, auto at, int length) { add_row(copies + copy, length, cells + at); });
  wait(receiving_);
  for (Neighbour const& n : readers_)
    for (PackedBox const& p : n.boxes)
      for_each_row(p.extent, p.packed, p.at,
                   [&](auto packed, auto at, int length) { add_row(n.buffer.data() + packed, length, cells + at); });
}

}  // namespace amrpic::matrixfree
