#include "mesh/exchange.hpp"

#include <algorithm>
#include <numeric>
#include <stdexcept>

namespace amrpic {

namespace {
constexpr int tag_plan = 7101;
constexpr int tag_values = 7102;
}  // namespace

std::vector<GlobalIndex> remote_cells(Level const& level, std::vector<GlobalIndex> numbers) {
  numbers.erase(std::remove_if(numbers.begin(), numbers.end(), [&](GlobalIndex n) { return n < 0 || level.owns(n); }),
                numbers.end());
  std::sort(numbers.begin(), numbers.end());
  numbers.erase(std::unique(numbers.begin(), numbers.end()), numbers.end());
  return numbers;
}

void append_remote(Level const& level, Box const& region, std::vector<GlobalIndex>& out) {
  if (level.ranks() == 1) return;
  level.for_each_overlap(region, [&](int b, Box const& part, Index3 const& shift) {
    if (level.owner(b) == level.rank()) return;
    for_each_row(level, b, part, shift, [&](GlobalIndex first, LocalIndex count, Index3 const&) {
      for (LocalIndex i = 0; i < count; ++i) out.push_back(first + i);
    });
  });
}

Exchange::Exchange(MPI_Comm comm, Level const& level, std::vector<GlobalIndex> halo) : halo_(std::move(halo)) {
  make(comm, level, halo_);
}

Exchange::Exchange(MPI_Comm comm, Level const& level, std::vector<GlobalIndex> const& whole_halo,
                   std::vector<GlobalIndex> const& subset)
    : halo_(whole_halo) {
  make(comm, level, subset);
}

LocalIndex Exchange::local(GlobalIndex cell) const {
  GlobalIndex const own = cell - first_;
  if (own >= 0 && own < owned_) return LocalIndex(own);
  auto const at = std::lower_bound(halo_.begin(), halo_.end(), cell);
  if (at == halo_.end() || *at != cell)
    throw std::logic_error("cell " + std::to_string(cell) + " is neither owned nor in the halo");
  return owned_ + LocalIndex(at - halo_.begin());
}

ArrayOnBox<LocalIndex> Exchange::places(Level const& level, Box const& region) const {
  ArrayOnBox<LocalIndex> out(region, no_place);
  level.for_each_overlap(region, [&](int b, Box const& part, Index3 const& shift) {
    for_each_row(level, b, part, shift, [&](GlobalIndex first, LocalIndex count, Index3 const& cell) {
      write_places(first, count, &out(cell));
    });
  });
  return out;
}

/// Places of cells with consecutive numbers, of one rank.
void Exchange::write_places(GlobalIndex first, LocalIndex count, LocalIndex* out) const {
  GlobalIndex const own = first - first_;
  if (own >= 0 && own < owned_) return std::iota(out, out + count, LocalIndex(own));
  for (auto at = std::lower_bound(halo_.begin(), halo_.end(), first); at != halo_.end() && *at < first + count; ++at)
    out[*at - first] = owned_ + LocalIndex(at - halo_.begin());
}

void Exchange::make(MPI_Comm comm, Level const& level, std::vector<GlobalIndex> const& wanted) {
  comm_ = comm;
  first_ = level.first_local_cell();
  owned_ = level.local_cells();

  int const ranks = level.ranks();
  std::vector<std::vector<GlobalIndex>> from(ranks);
  auto begin = wanted.begin();
  for (int r = 0; r < ranks; ++r) {
    auto const end = std::lower_bound(begin, wanted.end(), level.first_cell(r + 1));
    from[r].assign(begin, end);
    begin = end;
  }

  std::vector<int> ask(ranks), answer(ranks);
  for (int r = 0; r < ranks; ++r) ask[r] = int(from[r].size());
  MPI_Alltoall(ask.data(), 1, MPI_INT, answer.data(), 1, MPI_INT, comm);

  std::vector<std::vector<GlobalIndex>> to(ranks);
  std::vector<MPI_Request> requests;
  for (int r = 0; r < ranks; ++r)
    if (answer[r] > 0) {
      to[r].resize(answer[r]);
      MPI_Irecv(to[r].data(), answer[r], MPI_INT64_T, r, tag_plan, comm, &requests.emplace_back());
    }
  for (int r = 0; r < ranks; ++r)
    if (ask[r] > 0) MPI_Isend(from[r].data(), ask[r], MPI_INT64_T, r, tag_plan, comm, &requests.emplace_back());
  MPI_Waitall(int(requests.size()), requests.data(), MPI_STATUSES_IGNORE);

  auto neighbours = [&](std::vector<std::vector<GlobalIndex>> const& cells, LocalIndex origin) {
    std::vector<Neighbour> out;
    for (int r = 0; r < ranks; ++r) {
      if (cells[r].empty()) continue;
      Neighbour n{r, {}, {}};
      n.cells.reserve(cells[r].size());
      for (GlobalIndex cell : cells[r]) n.cells.push_back(local(cell) - origin);
      out.push_back(std::move(n));
    }
    return out;
  };
  sources_ = neighbours(from, owned_);
  readers_ = neighbours(to, 0);
  requests_.resize(sources_.size() + readers_.size());
}

void Exchange::post(std::vector<Neighbour> const& receive, std::vector<Neighbour> const& send,
                    std::size_t fields) const {
  std::size_t request = 0;
  for (auto const& n : receive) {
    n.buffer.resize(n.cells.size() * fields);
    MPI_Irecv(n.buffer.data(), int(n.buffer.size()), MPI_DOUBLE, n.rank, tag_values, comm_, &requests_[request++]);
  }
  for (auto const& n : send) {
    MPI_Isend(n.buffer.data(), int(n.buffer.size()), MPI_DOUBLE, n.rank, tag_values, comm_, &requests_[request++]);
    ++messages_;
    bytes_ += std::int64_t(n.buffer.size() * sizeof(Real));
  }
  MPI_Waitall(int(request), requests_.data(), MPI_STATUSES_IGNORE);
}

void Exchange::pack(std::vector<Neighbour> const& neighbours, std::vector<Real const*> const& fields,
                    std::ptrdiff_t stride) {
  for (auto const& n : neighbours) {
    n.buffer.resize(n.cells.size() * fields.size());
    Real* out = n.buffer.data();
    for (Real const* field : fields)
      for (LocalIndex cell : n.cells) *out++ = field[cell * stride];
  }
}

void Exchange::update(std::vector<Real const*> const& own, std::vector<Real*> const& halo,
                      std::ptrdiff_t stride) const {
  pack(readers_, own, stride);
  post(sources_, readers_, own.size());
  for (auto const& n : sources_) {
    Real const* in = n.buffer.data();
    for (Real* field : halo)
      for (LocalIndex cell : n.cells) field[cell * stride] = *in++;
  }
}

void Exchange::fold(std::vector<Real*> const& own, std::vector<Real const*> const& halo) const {
  pack(sources_, halo, 1);
  post(readers_, sources_, own.size());
  for (auto const& n : readers_) {
    Real const* in = n.buffer.data();
    for (Real* field : own)
      for (LocalIndex cell : n.cells) field[cell] += *in++;
  }
}

}  // namespace amrpic
