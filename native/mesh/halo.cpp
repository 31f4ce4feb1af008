#include "mesh/halo.hpp"

#include <algorithm>
#include <numeric>

#include "base/error.hpp"

namespace amrpic {

namespace {

/// Ascending runs that hold each cell once.
std::vector<NumberRun> merged(std::vector<NumberRun> runs) {
  std::sort(runs.begin(), runs.end(), [](NumberRun const& a, NumberRun const& b) { return a.first < b.first; });
  std::vector<NumberRun> out;
  for (NumberRun const& run : runs) {
    if (out.empty() || run.first > out.back().first + out.back().count) {
      out.push_back(run);
      continue;
    }
    GlobalIndex const end = std::max(out.back().first + out.back().count, run.first + run.count);
    out.back().count = LocalIndex(end - out.back().first);
  }
  return out;
}

std::int64_t cells_of(std::vector<NumberRun> const& runs) {
  return std::accumulate(runs.begin(), runs.end(), std::int64_t(0),
                         [](std::int64_t sum, NumberRun const& run) { return sum + run.count; });
}

}  // namespace

void CellReads::add_part(Read const& read, std::vector<NumberRun>& out) const {
  for_each_row(*owners_, read.owner, read.part, read.shift, [&](GlobalIndex first, LocalIndex count, Index3 const&) {
    out.push_back({first, count});
  });
}

void CellReads::add(Reads const& reads) {
  for (Read const& read : reads.wanted) add_part(read, wanted_);
  for (Read const& read : reads.asked) add_part(read, asked_[read.rank]);
}

std::vector<NumberRun> CellReads::wanted() const { return merged(wanted_); }

std::map<int, std::vector<NumberRun>> CellReads::asked() const {
  std::map<int, std::vector<NumberRun>> out;
  for (auto const& [rank, runs] : asked_)
    if (!runs.empty()) out[rank] = merged(runs);
  return out;
}

Halo::Halo(Communicator const& comm, CellReads const& reads) : cells_(reads.wanted()) {
  for (NumberRun const& run : cells_) {
    places_.push_back(size_);
    size_ += run.count;
  }
  Level const& level = reads.owners();
  first_ = level.first_local_cell();
  owned_ = level.local_cells();
  std::vector<Parcel> asked, wanted;
  for (auto const& [rank, runs] : reads.asked()) {
    asked.push_back({rank, cells_of(runs)});
    asked_.emplace_back();
    for (NumberRun const& run : runs) asked_.back().push_back({LocalIndex(run.first - first_), run.count});
  }
  for (NumberRun run : reads.wanted())
    while (run.count > 0) {  // the last cell of a rank and the first one of the next may follow each other
      int const rank = level.owner_of_cell(run.first);
      LocalIndex const count = LocalIndex(std::min<GlobalIndex>(run.count, level.first_cell(rank + 1) - run.first));
      if (wanted.empty() || wanted.back().rank != rank) wanted.push_back({rank, 0}), wanted_.emplace_back();
      wanted.back().values += count;
      wanted_.back().push_back({local(run.first) - owned_, count});
      run.first += count, run.count -= count;
    }
  exchange_ = Exchange<Real>(comm, asked, wanted);
}

/// Number of the first run that ends behind a cell.
std::size_t Halo::first_run_from(GlobalIndex cell) const {
  auto const at = std::partition_point(cells_.begin(), cells_.end(),
                                       [&](NumberRun const& run) { return run.first + run.count <= cell; });
  return std::size_t(at - cells_.begin());
}

std::vector<GlobalIndex> Halo::numbers() const {
  std::vector<GlobalIndex> out;
  for (NumberRun const& run : cells_)
    for (LocalIndex n = 0; n < run.count; ++n) out.push_back(run.first + n);
  return out;
}

LocalIndex Halo::place_in_halo(GlobalIndex cell) const {
  std::size_t const r = first_run_from(cell);
  if (r == cells_.size() || cells_[r].first > cell)
    fail_alone("cell " + std::to_string(cell) + " is neither owned nor in the halo");
  return owned_ + places_[r] + LocalIndex(cell - cells_[r].first);
}

std::vector<LocalIndex> Halo::local(std::vector<GlobalIndex> const& cells) const {
  std::vector<LocalIndex> out(cells.size());
  std::transform(cells.begin(), cells.end(), out.begin(),
                 [&](GlobalIndex n) { return n < 0 ? LocalIndex(n) : local(n); });
  return out;
}

ArrayOnBox<LocalIndex> Halo::places(Level const& level, Box const& region) const {
  ArrayOnBox<LocalIndex> out(region, no_place);
  level.for_each_overlap(region, [&](int b, Box const& part, Index3 const& shift) {
    for_each_row(level, b, part, shift, [&](GlobalIndex first, LocalIndex count, Index3 const& cell) {
      write_places(first, count, &out(cell));
    });
  });
  return out;
}

/// Places of cells with consecutive numbers, of one rank.
void Halo::write_places(GlobalIndex first, LocalIndex count, LocalIndex* out) const {
  GlobalIndex const own = first - first_;
  if (own >= 0 && own < owned_) return std::iota(out, out + count, LocalIndex(own));
  for (std::size_t r = first_run_from(first); r < cells_.size() && cells_[r].first < first + count; ++r) {
    GlobalIndex const begin = std::max(first, cells_[r].first);
    GlobalIndex const end = std::min(first + count, cells_[r].first + cells_[r].count);
    std::iota(out + (begin - first), out + (end - first), owned_ + places_[r] + LocalIndex(begin - cells_[r].first));
  }
}

void Halo::update(std::vector<Real const*> const& own, std::vector<Real*> const& halo, std::ptrdiff_t stride) const {
  exchange_.update(
      [&](std::size_t n, Real* out) {
        for (Real const* field : own)
          for (PlaceRun const& run : asked_[n])
            for (LocalIndex i = 0; i < run.count; ++i) *out++ = field[(run.first + i) * stride];
      },
      [&](std::size_t n, Real const* in) {
        for (Real* field : halo)
          for (PlaceRun const& run : wanted_[n])
            for (LocalIndex i = 0; i < run.count; ++i) field[(run.first + i) * stride] = *in++;
      },
      own.size());
}

void Halo::fold(std::vector<Real*> const& own, std::vector<Real const*> const& halo, std::ptrdiff_t stride) const {
  exchange_.fold(
      [&](std::size_t n, Real* out) {
        for (Real const* field : halo)
          for (PlaceRun const& run : wanted_[n])
            for (LocalIndex i = 0; i < run.count; ++i) *out++ = field[(run.first + i) * stride];
      },
      [&](std::size_t n, Real const* in) {
        for (Real* field : own)
          for (PlaceRun const& run : asked_[n])
            for (LocalIndex i = 0; i < run.count; ++i) field[(run.first + i) * stride] += *in++;
      },
      own.size());
}

}  // namespace amrpic
