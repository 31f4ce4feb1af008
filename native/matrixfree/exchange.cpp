#include "matrixfree/exchange.hpp"

#include <map>
#include <numeric>

namespace amrpic::matrixfree {

namespace {

/// Call f(row of a, row of b) for the rows of two rectangles of equal extent.
template <class F>
void for_each_row(Index3 const& extent, Rectangle const& a, Rectangle const& b, F&& f) {
  for (int k = 0; k < extent[2]; ++k)
    for (int j = 0; j < extent[1]; ++j) f(a.place(0, j, k), b.place(0, j, k));
}

Rectangle dense(Index3 const& extent, std::ptrdiff_t origin) {
  return {origin, extent[0], std::ptrdiff_t(extent[0]) * extent[1]};
}

/// What every rank asks of every other: `mine[r]` goes to rank r; returns what each rank asks of this one. Collective.
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

}  // namespace

RectangleExchange::RectangleExchange(MPI_Comm comm, Level const& level, Layout const& layout,
                                     std::vector<Wanted> const& wanted)
    : comm_(comm) {
  auto place = [&](int b, Index3 const& lower) {
    Rectangle out = layout.box(b);
    Box const& box = level.box(b);
    out.origin = out.place(lower[0] - box.lower[0], lower[1] - box.lower[1], lower[2] - box.lower[2]);
    return out;
  };
  std::map<int, Neighbour> sources;
  std::vector<std::vector<int>> requests(std::size_t(level.ranks()));
  for (Wanted const& w : wanted) {
    Index3 const extent{w.cells.extent(0), w.cells.extent(1), w.cells.extent(2)};
    int const owner = level.owner(w.box);
    if (owner == level.rank()) {
      local_.push_back({extent, place(w.box, w.cells.lower), w.copy});
      continue;
    }
    Neighbour& source = sources[owner];
    source.rank = owner;
    source.pieces.push_back({extent, w.copy});
    source.cells += source.pieces.back().cells();
    auto& request = requests[std::size_t(owner)];
    request.insert(request.end(),
                   {w.box, w.cells.lower[0], w.cells.lower[1], w.cells.lower[2], extent[0], extent[1], extent[2]});
  }
  for (auto& [rank, source] : sources) sources_.push_back(std::move(source));
  if (level.ranks() == 1) return;
  auto const asked = all_to_all(comm, requests);
  for (int rank = 0; rank < level.ranks(); ++rank) {
    auto const& list = asked[std::size_t(rank)];
    if (list.empty()) continue;
    Neighbour reader;
    reader.rank = rank;
    for (std::size_t n = 0; n < list.size(); n += 7) {
      reader.pieces.push_back(
          {{list[n + 4], list[n + 5], list[n + 6]}, place(list[n], {list[n + 1], list[n + 2], list[n + 3]})});
      reader.cells += reader.pieces.back().cells();
    }
    readers_.push_back(std::move(reader));
  }
}

/// Send the buffers of `from` and receive those of `to`, of so many fields.
void RectangleExchange::pass(std::vector<Neighbour> const& from, std::vector<Neighbour> const& to,
                             std::size_t fields) const {
  requests_.clear();
  for (Neighbour const& n : to) {
    n.buffer.resize(n.cells * fields);
    MPI_Irecv(n.buffer.data(), int(n.buffer.size()), MPI_FLOAT, n.rank, 0, comm_, &requests_.emplace_back());
  }
  for (Neighbour const& n : from) {
    MPI_Isend(n.buffer.data(), int(n.buffer.size()), MPI_FLOAT, n.rank, 0, comm_, &requests_.emplace_back());
    ++messages_;
    bytes_ += std::int64_t(n.buffer.size() * sizeof(float));
  }
}

void RectangleExchange::update(std::vector<std::pair<float const*, float*>> const& fields) const {
  for (Neighbour const& n : readers_) {
    n.buffer.resize(n.cells * fields.size());
    std::ptrdiff_t at = 0;
    for (auto const& field : fields)
      for (Piece const& p : n.pieces) {
        for_each_row(p.extent, p.at, dense(p.extent, at), [&, from = field.first](std::ptrdiff_t a, std::ptrdiff_t b) {
          std::copy_n(from + a, p.extent[0], n.buffer.data() + b);
        });
        at += std::ptrdiff_t(p.cells());
      }
  }
  pass(readers_, sources_, fields.size());
  for (auto const& field : fields)
    for (Local const& l : local_)
      for_each_row(l.extent, l.cells, l.copy, [&, f = field](std::ptrdiff_t a, std::ptrdiff_t b) {
        std::copy_n(f.first + a, l.extent[0], f.second + b);
      });
  MPI_Waitall(int(requests_.size()), requests_.data(), MPI_STATUSES_IGNORE);
  for (Neighbour const& n : sources_) {
    std::ptrdiff_t at = 0;
    for (auto const& field : fields)
      for (Piece const& p : n.pieces) {
        for_each_row(p.extent, dense(p.extent, at), p.at, [&, to = field.second](std::ptrdiff_t a, std::ptrdiff_t b) {
          std::copy_n(n.buffer.data() + a, p.extent[0], to + b);
        });
        at += std::ptrdiff_t(p.cells());
      }
  }
}

void RectangleExchange::add(float const* copies, float* cells) const {
  auto add_row = [](float const* from, int n, float* to) {
    for (int i = 0; i < n; ++i) to[i] += from[i];
  };
  for (Neighbour const& n : sources_) {
    n.buffer.resize(n.cells);
    std::ptrdiff_t at = 0;
    for (Piece const& p : n.pieces) {
      for_each_row(p.extent, p.at, dense(p.extent, at), [&](std::ptrdiff_t a, std::ptrdiff_t b) {
        std::copy_n(copies + a, p.extent[0], n.buffer.data() + b);
      });
      at += std::ptrdiff_t(p.cells());
    }
  }
  pass(sources_, readers_, 1);
  for (Local const& l : local_)
    for_each_row(l.extent, l.copy, l.cells,
                 [&](std::ptrdiff_t a, std::ptrdiff_t b) { add_row(copies + a, l.extent[0], cells + b); });
  MPI_Waitall(int(requests_.size()), requests_.data(), MPI_STATUSES_IGNORE);
  for (Neighbour const& n : readers_) {
    std::ptrdiff_t at = 0;
    for (Piece const& p : n.pieces) {
      for_each_row(p.extent, dense(p.extent, at), p.at,
                   [&](std::ptrdiff_t a, std::ptrdiff_t b) { add_row(n.buffer.data() + a, p.extent[0], cells + b); });
      at += std::ptrdiff_t(p.cells());
    }
  }
}

}  // namespace amrpic::matrixfree
